"""Masks of single views brought to ids that hold across views, by where their pixels lie.

`tracked` moves pixels by depth and cameras; `flow_tracking` moves them in the pictures alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.evaluation.sight_lines import shown_points
from instok3d.geometry.cameras import invert_rigid, transform_points, unproject
from instok3d.types import Cameras

MIN_IOU = 0.25
"""Of two masks of two views, over what both views show, from which they may be one thing."""
MIN_SHARED_PX = 10
"""Pixels that two such masks must share."""


@dataclass(frozen=True)
class Link:
    """Two masks, numbered over all views, that lie on each other."""

    first: int
    second: int
    iou: float


def unmatched(masks: Int[Tensor, "view height width"]) -> Int[Tensor, "view height width"]:
    """Every mask of every view as a thing of its own, ids 1, 2, ...

    Args:
        masks: Ids of each view for itself; below 1 is no mask.
    """
    result = torch.zeros_like(masks)
    free = 1
    for view, ids in enumerate(masks):
        names = ids[ids > 0].unique()
        known = ids > 0
        result[view][known] = torch.searchsorted(names, ids[known]) + free
        free += len(names)
    return result


def tracked(
    masks: Int[Tensor, "view height width"],
    depths: Float[Tensor, "view height width"],
    cameras: Cameras,
) -> Int[Tensor, "view height width"]:
    """The masks with ids that hold across views.

    Each pixel is moved into each other view by depth and cameras. Two masks may be one thing where
    their IoU is at least MIN_IOU over the pixels that both views show. The best pairs are joined
    first, as long as no thing gets two masks in one view.

    Args:
        masks: Ids of each view for itself; below 1 is no mask.
        depths: z-depth, 0 where it is unknown.
        cameras: Of the views, unbatched.

    Returns:
        Ids 1, 2, ...; 0 = no mask.
    """
    own = unmatched(masks)
    return joined(own, _links(own, depths, cameras))


def joined(
    masks: Int[Tensor, "view height width"], links: Sequence[Link]
) -> Int[Tensor, "view height width"]:
    """The masks of things that links join, the best first, never two of one view.

    Args:
        masks: Numbered over all views, as `unmatched` gives them.
        links: Between these numbers.

    Returns:
        Ids 1, 2, ...; 0 = no mask.
    """
    count = int(masks.max()) if masks.numel() else 0
    view_of = torch.zeros(count + 1, dtype=torch.int64)
    for view, ids in enumerate(masks):
        view_of[ids.unique()] = view
    things = {number: {number} for number in range(1, count + 1)}
    thing_of = {number: number for number in range(1, count + 1)}
    for link in sorted(links, key=lambda link: -link.iou):
        first, second = thing_of[link.first], thing_of[link.second]
        views = [{int(view_of[mask]) for mask in things[each]} for each in (first, second)]
        if first == second or views[0] & views[1]:
            continue
        for mask in things.pop(second):
            things[first].add(mask)
            thing_of[mask] = first
    names = {thing: number for number, thing in enumerate(sorted(things), start=1)}
    table = torch.tensor([0, *(names[thing_of[mask]] for mask in range(1, count + 1))])
    return table[masks]


def _links(
    masks: Int[Tensor, "view height width"],
    depths: Float[Tensor, "view height width"],
    cameras: Cameras,
) -> list[Link]:
    """Pairs of masks of different views that overlap enough."""
    links = []
    for first in range(len(masks)):
        known = depths[first] > 0
        points = unproject(depths[first], cameras.intrinsics[first])[known]
        world = transform_points(invert_rigid(cameras.cam_from_world[first]), points)
        for second in range(len(masks)):
            if second == first:
                continue
            rows, pixels = shown_points(
                world, cameras.cam_from_world[second], cameras.intrinsics[second], depths[second]
            )
            here, there = masks[first][known][rows], masks[second].flatten()[pixels]
            links += overlaps(here, there)
    return links


def overlaps(here: Int[Tensor, " pixel"], there: Int[Tensor, " pixel"]) -> list[Link]:
    """Pairs of masks with enough in common among pixels that show the same surface.

    Args:
        here: Numbers of masks of one view; below 1 is none.
        there: Of another view, where it shows the same.
    """
    pairs, shared = torch.stack([here, there]).unique(dim=1, return_counts=True)
    areas = [ids.bincount(minlength=1) for ids in (here, there)]
    links = []
    for (first, second), common in zip(pairs.T.tolist(), shared.tolist(), strict=True):
        if first > 0 and second > 0 and common >= MIN_SHARED_PX:
            iou = common / (int(areas[0][first]) + int(areas[1][second]) - common)
            if iou >= MIN_IOU:
                links.append(Link(first, second, iou))
    return links
