"""What a model sees of views at another size than theirs, and its geometry back at theirs."""

from dataclasses import replace

import torch
from torch import Tensor
from torch.nn import functional

from instok3d.types import Geometry, Views


def views_at(views: Views, height: int, width: int) -> Views:
    """The views at another size: photos averaged or interpolated, depth at the nearest pixel.

    Cameras stand; intrinsics are those of the new size.
    """
    old_height, old_width = views.images.shape[-2:]
    if (old_height, old_width) == (height, width):
        return views
    images = functional.interpolate(
        views.images.flatten(0, 1), (height, width), mode="bilinear", antialias=True
    )
    return replace(
        views,
        images=images.clamp(0, 1).unflatten(0, views.images.shape[:2]),
        intrinsics=None
        if views.intrinsics is None
        else _intrinsics_at(views.intrinsics, width / old_width, height / old_height),
        depths=None if views.depths is None else _nearest(views.depths, height, width),
    )


def geometry_at(geometry: Geometry, height: int, width: int) -> Geometry:
    """The geometry of the same views at another size, each pixel as the nearest one had it.

    The features stay those of the old patches.
    """
    old_height, old_width = geometry.depths.shape[-2:]
    if (old_height, old_width) == (height, width):
        return geometry
    points = [_nearest(axis, height, width) for axis in geometry.pointmaps.unbind(-1)]
    cameras = geometry.cameras
    return replace(
        geometry,
        depths=_nearest(geometry.depths, height, width),
        pointmaps=torch.stack(points, dim=-1),
        confidences=_nearest(geometry.confidences, height, width),
        cameras=replace(
            cameras,
            intrinsics=_intrinsics_at(cameras.intrinsics, width / old_width, height / old_height),
        ),
    )


def _intrinsics_at(intrinsics: Tensor, across: float, down: float) -> Tensor:
    """Of pictures that many times as wide and as high; pixel corners stay corners."""
    factors = intrinsics.new_tensor([across, down, 1])
    return factors[:, None] * intrinsics


def _nearest(maps: Tensor, height: int, width: int) -> Tensor:
    return functional.interpolate(maps, (height, width), mode="nearest-exact")
