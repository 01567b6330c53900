"""Many views in overlapping windows, whose groups `model.views.joining` makes those of one scene.

Not in the paper, whose models see eight views at once. A small one groups a part of a room better
than the whole (docs/log.md), and time grows with the number of views, not with its square.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from instok3d.geometry.cameras import relative_to_first, transform_points
from instok3d.model.views.view_path import order_along_path, view_overlaps
from instok3d.types import Cameras, Geometry, Views


def view_windows(geometry: Geometry, scene: int, size: int) -> list[list[int]]:
    """Numbers of the views in each window: neighbours of a path through all views.

    First windows of `size`, then pairs, each begun one view after the one before: groups can be
    followed from one to the next, and an anchor's assignment is the mean over several windows. All
    come again with their views in the opposite order, seen from their last camera. What is found
    differs a little each time, and the mean is better (docs/log.md). Views that fit in one window
    are that window alone.

    Args:
        geometry: Of the whole batch; says which views see the same.
        scene: Which of the batch.
        size: Views of a window, at least 2.
    """
    with torch.autocast(geometry.depths.device.type, enabled=False):
        path = order_along_path(view_overlaps(geometry, scene))
    if len(path) <= size:
        return [path]
    windows = [
        path[start : start + length]
        for length in _lengths(size)
        for start in range(len(path) - length + 1)
    ]
    return windows + [window[::-1] for window in windows]


def window_lengths(views: int, size: int) -> list[int]:
    """How many views each window of `view_windows` has."""
    if views <= size:
        return [views]
    return [length for length in _lengths(size) for _ in range(views - length + 1)] * 2


def middle_windows(windows: Sequence[Sequence[int]]) -> dict[int, int]:
    """For each view the largest window in whose middle it lies most, the first of equal ones."""
    distance: dict[int, tuple[int, float, int]] = {}
    for number, window in enumerate(windows):
        for place, view in enumerate(window):
            off = (-len(window), abs(place - (len(window) - 1) / 2), number)
            distance[view] = min(distance.get(view, off), off)
    return {view: number for view, (*_, number) in distance.items()}


def cut_window(
    views: Views, geometry: Geometry, scene: int, window: Sequence[int]
) -> tuple[Views, Geometry]:
    """Photos and geometry of some views as a batch of one, their first camera as the world."""
    chosen = torch.as_tensor(window, device=views.images.device)

    def cut(values: Tensor) -> Tensor:
        return values[scene, chosen][None]

    cam_from_world = cut(geometry.cameras.cam_from_world)
    points = cut(geometry.pointmaps)
    with torch.autocast(points.device.type, enabled=False):
        cameras = Cameras(relative_to_first(cam_from_world), cut(geometry.cameras.intrinsics))
        points = transform_points(cam_from_world[:, 0], points.flatten(1, 3)).view_as(points)
    return Views(cut(views.images)), Geometry(
        features=cut(geometry.features),
        depths=cut(geometry.depths),
        pointmaps=points,
        confidences=cut(geometry.confidences),
        cameras=cameras,
    )


def collate_geometry(parts: Sequence[Geometry]) -> Geometry:
    """One batch of all parts, which have as many views of one size."""

    def join(name: str) -> Tensor:
        return torch.cat([getattr(part, name) for part in parts])

    return Geometry(
        features=join("features"),
        depths=join("depths"),
        pointmaps=join("pointmaps"),
        confidences=join("confidences"),
        cameras=Cameras(
            torch.cat([part.cameras.cam_from_world for part in parts]),
            torch.cat([part.cameras.intrinsics for part in parts]),
        ),
    )


def _lengths(size: int) -> tuple[int, ...]:
    return (size, 2) if size > 2 else (size,)
