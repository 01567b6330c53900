import torch

from instok3d.model.anchors import AnchorPlacement
from instok3d.types import Context


def context_of(points: torch.Tensor, rng: torch.Generator) -> Context:
    batch, patches, _ = points.shape
    tokens = torch.randn(batch, patches, 8, generator=rng)
    return Context(tokens, points, torch.zeros(batch, patches, 1, 6), torch.ones(batch))


def test_anchors_stand_on_distinct_patches_that_lie_apart(rng):
    # Two tight clusters of three: two anchors must take one of each.
    cluster = 0.01 * torch.rand(1, 3, 3, generator=rng)
    seeds = AnchorPlacement(8, 2)(context_of(torch.cat([cluster, cluster + 5], dim=1), rng))
    first, second = seeds.patches[0].tolist()
    assert first < 3 <= second


def test_never_more_anchors_than_patches_and_none_twice(rng):
    context = context_of(torch.rand(2, 7, 3, generator=rng), rng)
    for count in (3, 7, 50):
        seeds = AnchorPlacement(8, count)(context)
        assert seeds.patches.shape == (2, min(count, 7))
        assert all(len(set(row)) == min(count, 7) for row in seeds.patches.tolist())


def test_a_seed_is_its_patchs_token_with_its_place(rng):
    context = context_of(torch.rand(2, 7, 3, generator=rng), rng)
    place = AnchorPlacement(8, 3)
    seeds = place(context)
    patch = int(seeds.patches[1, 2])
    torch.testing.assert_close(seeds.positions[1, 2], context.positions[1, patch])
    expected = context.tokens[1, patch] + place.position_embedding(context.positions[1, patch])
    torch.testing.assert_close(seeds.tokens[1, 2], expected)


def test_copies_of_the_first_anchor_fill_up_where_they_are_asked_for(rng):
    # As in the paper's released scenes: with 5 patches and 12 anchors, each patch once in the
    # order of farthest points, then 12 - 5 more copies of patch 0, which is where it starts.
    context = context_of(torch.rand(2, 5, 3, generator=rng), rng)
    seeds = AnchorPlacement(8, 12, pad_duplicates=True)(context)
    picked = seeds.patches
    assert picked.shape == (2, 12)
    assert all(sorted(row[:5]) == [0, 1, 2, 3, 4] for row in picked.tolist())
    assert picked[:, 0].tolist() == [0, 0]
    assert (picked[:, 5:] == 0).all()
    torch.testing.assert_close(seeds.tokens[:, 5:], seeds.tokens[:, :1].expand(-1, 7, -1))
    few = AnchorPlacement(8, 3, pad_duplicates=True)(context)
    assert torch.equal(few.patches, picked[:, :3])
