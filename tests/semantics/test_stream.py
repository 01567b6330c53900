import pytest
import torch
from torch import nn

from instok3d.model.transformer import Attention, Decoder
from instok3d.semantics.stream import SemanticLayer, SemanticStream

WIDTH, FEATURES = 16, 6


def decoder(*, self_attention: bool) -> Decoder:
    torch.manual_seed(0)
    made = Decoder(WIDTH, 3, self_attention=self_attention, head_size=8, normalize_heads=True)
    return made.requires_grad_(False)


def own_maps(stream: SemanticStream, frozen: Decoder) -> None:
    """Give the stream the maps of the decoder itself."""
    for name, module in {
        "source": nn.Identity(),
        "start": nn.Identity(),
        "norm": frozen.norm,
    }.items():
        setattr(stream, name, module)
    for own, layer in zip(stream.layers, frozen.each_layer(), strict=True):
        assert isinstance(own, SemanticLayer)
        own.cross_value.weight.data = layer.cross_attention.key_value.weight.chunk(2)[1]
        own.cross_out, own.mlp = layer.cross_attention.out, layer.mlp
        if layer.self_attention is not None:
            assert own.self_value is not None
            own.self_norm, own.self_out = layer.self_norm, layer.self_attention.out
            own.self_value.weight.data = layer.self_attention.key_value.weight.chunk(2)[1]


def test_other_values_are_gathered_by_the_same_weights(rng):
    attention = Attention(WIDTH, head_size=8, normalize_heads=True)
    tokens, context, values = (torch.randn(2, n, WIDTH, generator=rng) for n in (5, 7, 7))
    # The weights show themselves in values that are one for one source alone.
    weights = torch.stack([
        attention.forward_with(tokens, context, each.expand(2, 7, WIDTH))[1][..., ::8]
        for each in torch.eye(7)[..., None]
    ])  # fmt: skip
    torch.testing.assert_close(weights.sum(0), torch.ones(2, 5, 2))
    expected = torch.einsum("sbth,bshc->bthc", weights, values.unflatten(-1, (2, 8)))
    own, found = attention.forward_with(tokens, context, values)
    assert torch.equal(own, attention(tokens, context))
    torch.testing.assert_close(found, expected.flatten(2), atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("self_attention", [False, True])
def test_with_the_maps_of_the_decoder_the_stream_is_the_decoder(rng, self_attention):
    frozen = decoder(self_attention=self_attention)
    stream = SemanticStream(FEATURES, frozen)
    own_maps(stream, frozen)
    seeds, context = (torch.randn(1, n, WIDTH, generator=rng) for n in (5, 9))
    tokens, lifted = stream(frozen, seeds, context, context)
    assert torch.equal(tokens, frozen(seeds, context))
    torch.testing.assert_close(lifted, tokens, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("self_attention", [False, True])
def test_the_stream_learns_and_the_decoder_stays(rng, self_attention):
    frozen = decoder(self_attention=self_attention)
    stream = SemanticStream(FEATURES, frozen)
    seeds = torch.randn(1, 5, WIDTH, generator=rng, requires_grad=True)
    context = torch.randn(1, 9, WIDTH, generator=rng, requires_grad=True)
    features = torch.randn(1, 9, FEATURES, generator=rng, requires_grad=True)
    tokens, lifted = stream(frozen, seeds, context, features)
    assert not tokens.requires_grad
    lifted.square().sum().backward()
    assert all(p.grad is not None and p.grad.any() for p in stream.parameters())
    assert all(p.grad is None for p in frozen.parameters())
    assert seeds.grad is context.grad is None
    assert features.grad is not None


def test_anchors_keep_their_order_and_no_anchor_is_no_trouble(rng):
    frozen = decoder(self_attention=True)
    stream = SemanticStream(FEATURES, frozen)
    seeds, context = (torch.randn(1, n, WIDTH, generator=rng) for n in (5, 9))
    features = torch.randn(1, 9, FEATURES, generator=rng)
    _, lifted = stream(frozen, seeds, context, features)
    order, shuffled = torch.randperm(5, generator=rng), torch.randperm(9, generator=rng)
    _, again = stream(frozen, seeds[:, order], context[:, shuffled], features[:, shuffled])
    torch.testing.assert_close(again, lifted[:, order], atol=1e-5, rtol=1e-4)
    assert stream(frozen, seeds[:, :0], context, features)[1].shape == (1, 0, WIDTH)
