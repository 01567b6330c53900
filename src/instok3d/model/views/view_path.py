"""Overlaps of views, and an order of the views in which neighbours overlap."""

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.cameras import project, transform_points
from instok3d.types import Geometry

CELL = 8
"""Points are sampled on a grid with this stride, pixels."""
DEPTH_TOLERANCE = 0.25
"""A point is visible where its depth differs from the depth map by no more than this share."""


@torch.no_grad()
def view_overlaps(geometry: Geometry, scene: int) -> Float[Tensor, "view view"]:
    """Overlap of each pair of views: the share of visible points, mean of both directions.

    A point is visible in another view if it projects into its image, in front of the camera, and
    agrees with its depth map. Points that are not finite count as not visible. The diagonal is 0.

    Args:
        geometry: Pointmaps, depths and cameras.
        scene: Index in the batch.
    """
    points = geometry.pointmaps[scene, :, CELL // 2 :: CELL, CELL // 2 :: CELL].flatten(1, 2)
    cameras, depths = geometry.cameras, geometry.depths[scene]
    height, width = depths.shape[-2:]
    seen = []
    for view, depth in enumerate(depths):
        here = transform_points(cameras.cam_from_world[scene, view], points.flatten(0, 1))
        pixels = project(here, cameras.intrinsics[scene, view])
        x, y = pixels.nan_to_num(-1, -1, -1).clamp(-1, max(height, width)).floor().long().unbind(-1)
        inside = (here[:, 2] > 0) & (x >= 0) & (x < width) & (y >= 0) & (y < height)
        found = depth[y.clamp(0, height - 1), x.clamp(0, width - 1)]
        agrees = (found - here[:, 2]).abs() <= DEPTH_TOLERANCE * here[:, 2]
        seen.append((inside & agrees).view(len(depths), -1).float().mean(dim=1))
    share = torch.stack(seen, dim=1)
    return ((share + share.mT) / 2).fill_diagonal_(0)


def order_along_path(overlaps: Float[Tensor, "view view"]) -> list[int]:
    """All views in an order in which neighbours overlap.

    Greedy insertion: starts with the pair of largest overlap, then repeatedly inserts the view at
    the position that adds most to the summed overlap of neighbours. The end with the smaller view
    index comes first.
    """
    share = overlaps.tolist()
    pairs = [(first, second) for second in range(len(share)) for first in range(second)]
    path = list(max(pairs, key=lambda pair: share[pair[0]][pair[1]])) if pairs else [0]
    left = [view for view in range(len(share)) if view not in path]
    while left:
        places = [(place, view) for view in left for place in range(len(path) + 1)]
        place, view = max(places, key=lambda one: _gain(share, path, *one))
        path.insert(place, view)
        left.remove(view)
    return path if path[0] <= path[-1] else path[::-1]


def _gain(share: list[list[float]], path: list[int], place: int, view: int) -> float:
    """Change of the summed overlap of neighbours if the view is inserted before that position."""
    before, after = path[place - 1 : place], path[place : place + 1]
    gain = sum(share[view][neighbour] for neighbour in before + after)
    return gain - (share[before[0]][after[0]] if before and after else 0.0)
