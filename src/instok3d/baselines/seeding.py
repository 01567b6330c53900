"""Where the Gaussians of one scene begin: points of the known depth of its context views."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from instok3d.evaluation.methods import Shown
from instok3d.evaluation.sight_lines import shown_points
from instok3d.geometry.cameras import invert_rigid, transform_points, unproject
from instok3d.geometry.spherical_harmonics import SH_CONSTANT
from instok3d.types import Gaussians

START_OPACITY = 0.1
NEIGHBORS = 3
"""Whose mean distance is the first size of a Gaussian, as in 3DGS."""


@dataclass(frozen=True)
class SeedPoints:
    """Points of surfaces in the world of the cameras."""

    positions: Float[Tensor, "point 3"]
    colors: Float[Tensor, "point 3"]
    """sRGB in [0, 1]."""


def seed_points(shown: Shown, count: int, *, seed: int) -> SeedPoints:
    """Points behind pixels of known depth, drawn at random without replacement.

    Args:
        shown: With cameras and depth.
        count: At most so many.
        seed: Of the draw.

    Raises:
        ValueError: Depth is not shown, or no pixel has any.
    """
    depths = known_depths(shown)
    points = world_points(shown)[depths > 0]
    if not len(points):
        raise ValueError("no pixel of the context views has a known depth to start from")
    colors = shown.views.images[0].permute(0, 2, 3, 1)[depths > 0]
    order = torch.randperm(len(points), generator=torch.Generator().manual_seed(seed))[:count]
    return SeedPoints(points[order], colors[order])


def known_depths(shown: Shown) -> Float[Tensor, "view height width"]:
    """The depth that is shown.

    Raises:
        ValueError: None is.
    """
    if shown.views.depths is None:
        raise ValueError("the depth of the context views is not shown; need 'depth'")
    return shown.views.depths[0]


def world_points(shown: Shown) -> Float[Tensor, "view height width 3"]:
    """The point behind every pixel; those of unknown depth lie in the camera's centre."""
    cameras, depths = shown.cameras, known_depths(shown)
    points = unproject(depths, cameras.intrinsics).flatten(1, 2)
    return transform_points(invert_rigid(cameras.cam_from_world), points).view(*depths.shape, 3)


def seeded_gaussians(points: SeedPoints, *, sh_degree: int) -> Gaussians:
    """A round Gaussian for each point, as large as its distance to the nearest others.

    Each is its own anchor.
    """
    count = len(points.positions)
    sh = points.colors.new_zeros(count, (sh_degree + 1) ** 2, 3)
    sh[:, 0] = (points.colors - 0.5) / SH_CONSTANT
    return Gaussians(
        means=points.positions,
        quats=points.positions.new_tensor([1.0, 0, 0, 0]).expand(count, 4),
        scales=_spacing(points.positions)[:, None].expand(count, 3),
        opacities=points.positions.new_full((count,), START_OPACITY),
        sh=sh,
        anchor_index=torch.arange(count),
    )


def _spacing(positions: Float[Tensor, "point 3"]) -> Float[Tensor, " point"]:
    """Mean distance to the NEIGHBORS nearest other points; a hundredth where there is none."""
    neighbors = min(NEIGHBORS, len(positions) - 1)
    if neighbors < 1:
        return positions.new_full((len(positions),), 0.01)
    points = positions.numpy()
    distances, _ = KDTree(points).query(points, k=neighbors + 1)
    return torch.from_numpy(distances[:, 1:].mean(axis=1)).float().clamp_min(1e-4)


def voted_labels(positions: Float[Tensor, "point 3"], shown: Shown) -> Int[Tensor, " point"]:
    """The id that most views give each point where they see it; 0 where none gives one.

    A point that another surface hides takes no vote of that (`sight_lines.shown_points`): a wall
    behind a chair would become the chair's. Of equal counts the lower id wins.

    Args:
        positions: World frame of the cameras.
        shown: With cameras, depth and masks.

    Raises:
        ValueError: One of these is not shown.
    """
    if shown.masks is None:
        raise ValueError("the masks of the context views are not shown; need 'masks'")
    cameras, depths = shown.cameras, known_depths(shown)
    votes = torch.zeros(len(positions), max(int(shown.masks.max()), 0) + 1, dtype=torch.int64)
    for view, ids in enumerate(shown.masks):
        seen, pixels = shown_points(
            positions, cameras.cam_from_world[view], cameras.intrinsics[view], depths[view]
        )
        votes[seen, ids.flatten()[pixels].clamp_min(0)] += 1  # a view sees each point once
    votes[:, 0] = 0
    return votes.argmax(dim=1)
