import pytest
import torch

from instok3d.model.transformer import Attention, Decoder


def test_attention_to_one_vector_returns_its_value(rng):
    # The softmax over a single source is 1, so every token gathers out(value(source)).
    attention = Attention(8, head_size=4)
    source = torch.randn(1, 1, 8, generator=rng)
    gathered = attention(torch.randn(1, 5, 8, generator=rng), source)
    value = attention.key_value(source)[..., 8:]
    torch.testing.assert_close(gathered, attention.out(value).expand(1, 5, 8))


@pytest.mark.parametrize("self_attention", [False, True])
def test_decoder_permutes_with_its_queries_and_not_with_its_context(rng, self_attention):
    decoder = Decoder(8, 2, self_attention=self_attention, head_size=4)
    queries = torch.randn(1, 6, 8, generator=rng)
    context = torch.randn(1, 9, 8, generator=rng)
    decoded = decoder(queries, context)
    order, shuffled = torch.randperm(6, generator=rng), torch.randperm(9, generator=rng)
    torch.testing.assert_close(
        decoder(queries[:, order], context[:, shuffled]), decoded[:, order], atol=1e-5, rtol=1e-4
    )


def test_bfloat16_autocast_stays_near_float32(rng):
    decoder = Decoder(64, 2, self_attention=True, normalize_heads=True)
    queries = torch.randn(1, 6, 64, generator=rng)
    context = torch.randn(1, 9, 64, generator=rng)
    exact = decoder(queries, context)
    with torch.autocast("cpu", torch.bfloat16):
        rough = decoder(queries, context)
    # Layer-normalised, so of unit size; bfloat16 has 8 bits, a few layers lose two more.
    torch.testing.assert_close(rough.float(), exact, atol=0.05, rtol=0)


def test_a_width_that_heads_do_not_divide_is_named():
    with pytest.raises(ValueError, match="multiple of head_size=64, got width=96"):
        Attention(96)
