"""Depths of several views, averaged where the views see the same surface."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from instok3d.geometry.cameras import invert_rigid, pixel_rays, transform_points

AGREEMENT = 0.06
"""Standard deviation of the difference between two views' log depths of the same surface. A
difference of several of these means another surface, as behind a depth discontinuity."""
NEAREST = 1e-6
"""Depth below which a point counts as behind the camera."""


@torch.no_grad()
def agree_on_depths(
    depths: Float[Tensor, "batch view height width"],
    confidences: Float[Tensor, "batch view height width"],
    cam_from_world: Float[Tensor, "batch view 4 4"],
    intrinsics: Float[Tensor, "batch view 3 3"],
) -> Float[Tensor, "batch view height width"]:
    """Log-depth correction of each pixel towards the depths of the other views.

    1. Project the point of each pixel into every other view.
    2. There, compare the view's log depth with that of the point. Differences far beyond AGREEMENT
       get almost no weight: they are occlusions.
    3. Average the differences over all views, weighted by confidence. The pixel's own view takes
       part with difference 0, so that a single view changes nothing.

    The difference is applied along the pixel's own ray, which is exact only for small baselines.
    Not differentiable.

    Args:
        depths: > 0, in the units of the cameras.
        confidences: > 0, comparable between views.
        cam_from_world: Cameras of all views.
        intrinsics: Pixels.
    """
    batch, count, height, width = depths.shape
    size = torch.tensor([width, height]).to(depths)
    surfaces = torch.stack([depths.log(), confidences], dim=2).flatten(0, 1)
    corrections = []
    for view in range(count):
        rays = pixel_rays(intrinsics[:, view], height, width)
        points = (rays * depths[:, view, ..., None]).flatten(1, 2)
        other_from_here = cam_from_world @ invert_rigid(cam_from_world[:, view])[:, None]
        seen = transform_points(other_from_here, points[:, None].expand(-1, count, -1, -1))
        depth = seen[..., 2].clamp_min(NEAREST)
        positions = (seen @ intrinsics.mT)[..., :2] / depth[..., None]
        inside = (seen[..., 2] > NEAREST) & ((positions > 0) & (positions < size)).all(-1)
        inside[:, view] = False
        found = functional.grid_sample(
            surfaces,
            (positions / size * 2 - 1).flatten(0, 1)[:, None],
            padding_mode="border",
            align_corners=False,
        ).view(batch, count, 2, -1)
        difference = found[:, :, 0] - depth.log()
        weight = inside * found[:, :, 1] * torch.exp(-0.5 * (difference / AGREEMENT).square())
        total = confidences[:, view].flatten(1) + weight.sum(1)
        corrections.append(((weight * difference).sum(1) / total).view(batch, height, width))
    return torch.stack(corrections, dim=1)
