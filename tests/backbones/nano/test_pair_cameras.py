"""Cameras from matches of pairs, some of which are wrong."""

import pytest
import torch
from torch import Tensor

from instok3d.backbones.nano.bundle_problem import SolveSettings
from instok3d.backbones.nano.matching import PEAK_ERROR_PX, Matches, cell_centers, join_matches
from instok3d.backbones.nano.pair_cameras import solve_views
from instok3d.backbones.nano.pair_matches import PairMatches, PhotoViews
from instok3d.geometry.cameras import invert_rigid, project, transform_points
from instok3d.geometry.registration import rigid_from_twist

SIZE = 64
INTRINSICS = torch.tensor([[60.0, 0, 32], [0, 60.0, 32], [0, 0, 1]])
CAMERAS = rigid_from_twist(
    torch.tensor(
        [
            [0.0, 0, 0, 0, 0, 0],
            [-0.2, 0.05, 0, 0, 0.05, 0.02],
            [-0.4, 0, 0.1, 0.03, 0.1, 0],
            [-0.5, 0.1, 0, 0, 0.15, -0.05],
        ]
    )
)


def depth_of_wall(cam_from_world: Tensor, pixels: Tensor) -> Tensor:
    """Of the plane 0.3 x + 0.2 y + z = 2 of the world, at pixels [..., 2]."""
    normal = torch.tensor([0.3, 0.2, 1.0])
    turned = cam_from_world[:3, :3] @ normal
    distance = 2.0 + turned @ cam_from_world[:3, 3]
    rays = torch.cat([pixels, torch.ones_like(pixels[..., :1])], -1) @ INTRINSICS.inverse().mT
    return distance / (rays @ turned)


def matches(here: Tensor, there: Tensor) -> Matches:
    """Of every cell, exact; of no confidence where it leaves the other image."""
    centers = cell_centers(SIZE // 4, SIZE // 4, like=here)
    rays = torch.cat([centers, torch.ones_like(centers[:, :1])], -1) @ INTRINSICS.inverse().mT
    points = rays * depth_of_wall(here, centers)[:, None]
    pixels = project(transform_points(there @ invert_rigid(here), points), INTRINSICS)
    inside = ((pixels > 0) & (pixels < SIZE)).all(-1)
    precision = torch.eye(2).expand(1, len(centers), 2, 2) / PEAK_ERROR_PX**2
    return Matches(centers, pixels.clamp(1, SIZE - 1)[None], precision, 0.95 * inside[None].float())


def pair(first: int, second: int) -> PairMatches:
    numbers = torch.tensor([[first], [second]])
    a, b = CAMERAS[first], CAMERAS[second]
    return PairMatches(numbers[0], numbers[1], matches(a, b), matches(b, a))


def wrong_pair(first: int, second: int, rng: torch.Generator) -> PairMatches:
    """Anywhere, and sure of it."""
    found = pair(first, second)
    for one in (found.of_a, found.of_b):
        one.pixels.copy_(SIZE * torch.rand(one.pixels.shape, generator=rng))
        one.confidence.fill_(0.95)
    return found


def solve(pairs: list[PairMatches], views: int, scenes: int = 1) -> Tensor:
    """cam_from_first [scene view 4 4] of photos that show nothing: matches stay where they are."""
    places = torch.cartesian_prod(torch.arange(SIZE), torch.arange(SIZE)).flip(1) + 0.5
    depths = torch.stack([depth_of_wall(c, places).view(SIZE, SIZE) for c in CAMERAS[:views]])
    solved = solve_views(
        pairs,
        PhotoViews(
            torch.zeros(scenes, views, 3, SIZE, SIZE),
            depths.expand(scenes, -1, -1, -1),
            INTRINSICS.expand(scenes, views, 3, 3),
        ),
        SolveSettings(torch.zeros(scenes, views)),
    )
    return solved.cam_from_first


def test_exact_matches_give_the_cameras():
    found = solve([pair(0, 1), pair(1, 2), pair(2, 3), pair(0, 2)], 4)[0]
    torch.testing.assert_close(found, CAMERAS, atol=1e-2, rtol=0)
    torch.testing.assert_close(solve([pair(0, 1)], 2)[0], CAMERAS[:2], atol=1e-2, rtol=0)


def test_all_matches_count_in_the_end():
    """A quarter of them, all that the first rounds look at, are off by two pixels."""
    pairs = [pair(0, 1), pair(1, 2), pair(0, 2)]
    off = torch.zeros(16, 16)
    off[::2, ::2] = 2.0
    for one in pairs:
        one.of_a.pixels[..., 0] += off.flatten()
        one.of_b.pixels[..., 0] -= off.flatten()
    for views, found in ((2, solve(pairs[:1], 2)), (3, solve(pairs, 3))):
        torch.testing.assert_close(found[0], CAMERAS[:views], atol=2e-2, rtol=0)


@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_pair_is_gone_round(seed):
    """The pair that descriptors like best fits nothing: views are chained along pairs that do."""
    rng = torch.Generator().manual_seed(seed)
    found = solve([wrong_pair(0, 3, rng), pair(3, 2), pair(2, 1), pair(0, 1)], 4)[0]
    torch.testing.assert_close(found, CAMERAS, atol=1e-2, rtol=0)


def test_scenes_of_a_batch_have_trees_of_their_own():
    """One scene's wrong pair is another's right one."""

    def both(one: PairMatches, other: PairMatches) -> PairMatches:
        return PairMatches(
            torch.cat([one.views_a, other.views_a]),
            torch.cat([one.views_b, other.views_b]),
            join_matches([one.of_a, other.of_a]),
            join_matches([one.of_b, other.of_b]),
        )

    rng = torch.Generator().manual_seed(0)
    pairs = [
        both(wrong_pair(0, 1, rng), pair(0, 1)),
        both(pair(1, 2), pair(1, 2)),
        both(pair(0, 2), wrong_pair(0, 2, rng)),
    ]
    for scene in solve(pairs, 3, scenes=2):
        torch.testing.assert_close(scene, CAMERAS[:3], atol=1e-2, rtol=0)


def test_one_view_alone_is_the_world():
    torch.testing.assert_close(solve([], 1)[0], torch.eye(4)[None])
