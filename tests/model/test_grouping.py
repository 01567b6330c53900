import torch
from torch.nn import functional

from instok3d.model.grouping import Assignment, GroupDecoder, assign_anchors
from instok3d.model.transformer import Decoder
from instok3d.types import Anchors


def test_assignment_of_one_anchor_by_hand():
    # Logits 2, 0 and the void's 0: softmax gives e^2 : 1 : 1.
    pi = assign_anchors(torch.tensor([[[2.0]]]), torch.tensor([[[1.0], [0.0]]]))
    e2 = torch.tensor(2.0).exp()
    torch.testing.assert_close(pi, torch.stack([e2, e2 / e2, e2 / e2]).view(1, 1, 3) / (e2 + 2))


def test_zero_tokens_share_every_anchor_equally_with_the_void():
    pi = assign_anchors(torch.zeros(2, 3, 8), torch.zeros(2, 100, 8))
    torch.testing.assert_close(pi, torch.full((2, 3, 101), 1 / 101))


def test_an_anchor_unlike_every_group_goes_to_the_void():
    pi = assign_anchors(torch.tensor([[[-9.0]]]), torch.tensor([[[1.0], [2.0]]]))
    assert pi[0, 0, -1] > 0.999


def test_order_of_groups_only_permutes_columns(rng):
    assign = Assignment(16)
    anchors = torch.randn(2, 7, 16, generator=rng)
    groups = torch.randn(2, 3, 16, generator=rng)
    order = [2, 0, 1, 3]
    torch.testing.assert_close(
        assign(anchors, groups[:, order[:3]]), assign(anchors, groups)[..., order]
    )


def test_logits_start_in_a_useful_range(rng):
    # Unit variance before training: neither one-hot nor flat.
    assign = Assignment(256)
    pi = assign(torch.randn(1, 200, 256, generator=rng), torch.randn(1, 40, 256, generator=rng))
    logits = pi[..., :-1].log() - pi[..., -1:].log()
    assert 0.5 < logits.std() < 2.0


def test_groups_differ_from_each_other(rng):
    # Queries that were alike would stay alike for ever.
    decode = GroupDecoder(5, 8, Decoder(8, 2, self_attention=True, head_size=4))
    tokens = torch.randn(1, 9, 8, generator=rng)
    anchors = Anchors(torch.zeros(1, 9, 3), tokens, torch.arange(9)[None])
    groups = decode(anchors)[0]
    distances = torch.cdist(groups, groups) + 9 * torch.eye(5)
    assert distances.min() > 0.1


def test_without_projections_only_the_norms_and_the_temperature_learn(rng):
    assign = Assignment(8, project=False)
    sizes = {name: tuple(p.shape) for name, p in assign.named_parameters()}
    assert sorted(sizes.values()) == [(), (8,), (8,), (8,), (8,)]
    anchors, groups = (torch.randn(1, n, 8, generator=rng) for n in (3, 2))
    normed = [functional.layer_norm(x, (8,)) for x in (anchors, groups)]
    logits = normed[0] @ normed[1].mT / 8**0.5
    expected = torch.cat([logits, torch.zeros(1, 3, 1)], dim=-1).softmax(dim=-1)
    torch.testing.assert_close(assign(anchors, groups), expected)
