"""Many views as overlapping windows; `model.views.joining` merges the groups of the windows.

Not in the paper, whose models take eight views at once. A small model groups part of a room better
than the whole room (docs/log.md), and its time grows linearly with the number of views instead of
quadratically.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from instok3d.geometry.cameras import relative_to_first, transform_points
from instok3d.model.views.view_path import order_along_path, view_overlaps
from instok3d.types import Cameras, Geometry, Views


def view_windows(geometry: Geometry, scene: int, size: int) -> list[list[int]]:
    """The view indices of each window.

    1. Views are ordered along a path on which neighbours overlap most.
    2. A window of `size` slides along the path with stride 1, so that consecutive windows share
       views and their groups can be matched; then a window of 2 does the same.
    3. Every window is repeated with its views reversed: its world is then the last camera.

    An anchor's assignment is averaged over all windows that contain it; each makes other errors,
    so the mean is better than any one (docs/log.md). If all views fit into one window, it is the
    only one.

    Args:
        geometry: Of the whole batch; the overlaps are computed from it.
        scene: Index in the batch.
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
    """The number of views of each window that `view_windows` returns, in its order."""
    if views <= size:
        return [views]
    return [length for length in _lengths(size) for _ in range(views - length + 1)] * 2


def middle_windows(windows: Sequence[Sequence[int]]) -> dict[int, int]:
    """For each view the index of the longest window whose centre is nearest to it.

    Among equal ones, the first.
    """
    distance: dict[int, tuple[int, float, int]] = {}
    for number, window in enumerate(windows):
        for place, view in enumerate(window):
            off = (-len(window), abs(place - (len(window) - 1) / 2), number)
            distance[view] = min(distance.get(view, off), off)
    return {view: number for view, (*_, number) in distance.items()}


def cut_window(
    views: Views, geometry: Geometry, scene: int, window: Sequence[int]
) -> tuple[Views, Geometry]:
    """Photos and geometry of the window as a batch of one; the world is its first camera."""
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


def _lengths(size: int) -> tuple[int, ...]:
    return (size, 2) if size > 2 else (size,)
