from dataclasses import replace

import pytest
import torch

from instok3d.refinement.assignment import (
    reassigned,
    weights_by_group,
    weights_by_region,
    winning_columns,
)
from instok3d.render import render
from instok3d.types import Cameras, Gaussians

SIDE = 24
VIEW: dict = {"height": SIDE, "width": SIDE, "near": 0.05, "far": 100.0}
ASSIGNMENT = torch.tensor([[0.9, 0.05, 0.05], [0.05, 0.9, 0.05], [0.05, 0.05, 0.9]])
ANCHORS = torch.tensor([[-0.5, 0, 2], [0.5, 0, 2], [0.0, 0.0, 4.0]])


@pytest.fixture
def camera() -> Cameras:
    intrinsics = torch.tensor([[20.0, 0, SIDE / 2], [0, 20, SIDE / 2], [0, 0, 1]])
    return Cameras(torch.eye(4)[None], intrinsics[None])


def blobs(places: list[list[float]], anchors: list[int], sizes: list[float]) -> Gaussians:
    count = len(places)
    return Gaussians(
        torch.tensor(places), torch.tensor([[1.0, 0, 0, 0]] * count),
        torch.tensor(sizes)[:, None].expand(count, 3).contiguous(),
        torch.full((count,), 0.9), torch.zeros(count, 1, 3), torch.tensor(anchors),
    )  # fmt: skip


def test_weights_are_what_the_pixels_composite(camera: Cameras):
    gaussians = blobs([[-0.5, 0, 2], [0.5, 0, 2]], [0, 1], [0.2, 0.2])
    weights = weights_by_group(gaussians, ASSIGNMENT, camera, **VIEW)
    alphas = render(gaussians, camera, SIDE, SIDE, near=0.05, far=100.0).alphas
    torch.testing.assert_close(weights.sum(), alphas.sum())
    assert weights[0, 0] > 0.95 * weights[0].sum()
    assert weights[1, 1] > 0.95 * weights[1].sum()


def test_a_stray_in_front_of_another_object_joins_it(camera: Cameras):
    # A large blob of group 1; a small pale one of group 0 in the midst of it.
    gaussians = blobs([[0.5, 0, 2], [0.5, 0, 1.9], [-0.5, 0, 2]], [1, 0, 0], [0.3, 0.03, 0.3])
    gaussians = replace(gaussians, opacities=torch.tensor([0.95, 0.3, 0.95]))
    result = reassigned(gaussians, ASSIGNMENT, ANCHORS, camera, **VIEW)
    assert result.anchor_index.tolist() == [1, 1, 0]
    assert gaussians.anchor_index.tolist() == [1, 0, 0]
    for name, value in vars(replace(result, anchor_index=gaussians.anchor_index)).items():
        assert value is getattr(gaussians, name), name


def test_other_winners_may_be_given(camera: Cameras):
    gaussians = blobs([[-0.5, 0, 2], [0.5, 0, 2]], [0, 1], [0.2, 0.2])
    same = reassigned(gaussians, ASSIGNMENT, ANCHORS, camera, **VIEW)
    assert same.anchor_index.tolist() == [0, 1]
    all_first = torch.zeros(1, SIDE, SIDE, dtype=torch.long)
    given = reassigned(gaussians, ASSIGNMENT, ANCHORS, camera, **VIEW, winners=all_first)
    assert given.anchor_index.tolist() == [0, 0]


def test_it_joins_the_nearest_anchor_of_the_group(camera: Cameras):
    gaussians = blobs([[0.5, 0, 2], [0.5, 0, 1.9]], [1, 0], [0.3, 0.03])
    gaussians = replace(gaussians, opacities=torch.tensor([0.95, 0.3]))
    assignment = torch.cat([ASSIGNMENT, ASSIGNMENT[1:2]])
    anchors = torch.cat([ANCHORS, torch.tensor([[0.5, 0.0, 1.9]])])
    result = reassigned(gaussians, assignment, anchors, camera, **VIEW)
    assert result.anchor_index.tolist() == [1, 3]


def test_the_void_takes_none_and_what_shows_nothing_stays(camera: Cameras):
    in_void = blobs([[0.0, 0, 4], [0.0, 0, 3.9], [0.0, 0, -2.0]], [2, 0, 1], [0.9, 0.05, 0.3])
    in_void = replace(in_void, opacities=torch.tensor([0.95, 0.3, 0.9]))
    result = reassigned(in_void, ASSIGNMENT, ANCHORS, camera, **VIEW)
    assert torch.equal(result.anchor_index, in_void.anchor_index)
    none = in_void.rows(slice(0, 0))
    assert len(reassigned(none, ASSIGNMENT, ANCHORS, camera, **VIEW).means) == 0


def test_weights_add_up_over_the_views(camera: Cameras):
    gaussians = blobs([[-0.5, 0, 2], [0.5, 0, 2]], [0, 1], [0.2, 0.2])
    both = Cameras(
        torch.cat([camera.cam_from_world, camera.cam_from_world]),
        torch.cat([camera.intrinsics, camera.intrinsics]),
    )
    once = weights_by_group(gaussians, ASSIGNMENT, camera, **VIEW)
    twice = weights_by_group(gaussians, ASSIGNMENT, both, **VIEW)
    torch.testing.assert_close(twice, 2 * once)


def test_weights_of_joined_regions_are_the_sums_of_those_of_their_groups(camera: Cameras):
    generator = torch.Generator().manual_seed(3)
    places = torch.rand(60, 3, generator=generator) * torch.tensor([1.6, 1.6, 1]) + torch.tensor(
        [-0.8, -0.8, 2]
    )
    gaussians = blobs(places.tolist(), [index % 6 for index in range(60)], [0.1] * 60)
    assignment = torch.rand(6, 6, generator=generator)
    each = weights_by_group(gaussians, assignment, camera, **VIEW)
    winners = winning_columns(gaussians, assignment, camera, **VIEW)
    assert len(winners.unique()) > 3
    chosen = [int(winners.unique()[0]), int(winners.unique()[2])]
    within = torch.isin(winners, torch.tensor(chosen)).long()
    joined = weights_by_region(gaussians, within, 2, camera, near=0.05, far=100.0)
    torch.testing.assert_close(joined[:, 1], each[:, chosen].sum(1))
    torch.testing.assert_close(joined.sum(1), each.sum(1))
    none = gaussians.rows(slice(0, 0))
    assert weights_by_region(none, within, 2, camera, near=0.05, far=100.0).shape == (0, 2)
    no_views = camera.views([])
    unseen = weights_by_region(gaussians, within[:0], 2, no_views, near=0.05, far=100.0)
    assert unseen.shape == (60, 2)
    assert not unseen.any()


def test_one_that_shows_less_than_half_a_pixel_stays(camera: Cameras):
    gaussians = blobs([[0.5, 0, 2], [0.5, 0, 1.9]], [1, 0], [0.3, 0.001])
    gaussians = replace(gaussians, opacities=torch.tensor([0.95, 0.1]))
    result = reassigned(gaussians, ASSIGNMENT, ANCHORS, camera, **VIEW)
    assert result.anchor_index.tolist() == [1, 0]


def test_one_between_two_others_stays_where_none_has_more_than_half(camera: Cameras):
    """Its weight lies in the pixels of three groups."""
    wide = blobs(
        [[-0.5, 0, 2.5], [0.5, 0, 2.5], [0.0, 0.45, 2.5], [0.0, -0.05, 2.0]],
        [0, 1, 3, 4], [0.28, 0.28, 0.28, 0.25],
    )  # fmt: skip
    wide = replace(wide, opacities=torch.tensor([0.98, 0.98, 0.98, 0.2]))
    owners = torch.eye(6)[[0, 1, 5, 2, 3]]
    anchors = torch.zeros(5, 3)
    weights = weights_by_group(wide, owners, camera, **VIEW)[3]
    assert 0.34 < float(weights.max() / weights.sum()) < 0.5
    assert int(weights.argmax()) != 3
    result = reassigned(wide, owners, anchors, camera, **VIEW)
    assert result.anchor_index.tolist() == [0, 1, 3, 4]
