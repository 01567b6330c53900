"""Depths of several views, moved towards each other where they see one surface."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from instok3d.geometry.cameras import invert_rigid, pixel_rays, transform_points

AGREEMENT = 0.06
"""Standard deviation of the difference of two log depths of one surface; what is farther apart
than a few of these is something else, as behind a rim."""
NEAREST = 1e-6
"""Depth at which a point counts as behind a camera."""


@torch.no_grad()
def agree_on_depths(
    depths: Float[Tensor, "batch view height width"],
    confidences: Float[Tensor, "batch view height width"],
    cam_from_world: Float[Tensor, "batch view 4 4"],
    intrinsics: Float[Tensor, "batch view 3 3"],
) -> Float[Tensor, "batch view height width"]:
    """Change of log depth at each pixel, towards what the other views see there.

    The point of each pixel is looked up in every other view; by how much the surface there is
    deeper is taken over to the pixel's own ray. The mean over all views by their confidence, its
    own with no change. One view alone changes nothing. Not differentiable.

    Args:
        depths: > 0, in the units of the cameras.
        confidences: > 0, on one scale.
        cam_from_world: Cameras of all views.
        intrinsics: Pixels.
    """
    batch, count, height, width = depths.shape
    size = torch.tensor([width, height]).to(depths)
    surfaces = torch.stack([depths.log(), confidences], dim=2).flatten(0, 1)
    changes = []
    for view in range(count):
        rays = pixel_rays(intrinsics[:, view], height, width)
        points = (rays * depths[:, view, ..., None]).flatten(1, 2)
        other_from_here = cam_from_world @ invert_rigid(cam_from_world[:, view])[:, None]
        seen = transform_points(other_from_here, points[:, None].expand(-1, count, -1, -1))
        depth = seen[..., 2].clamp_min(NEAREST)
        places = (seen @ intrinsics.mT)[..., :2] / depth[..., None]
        inside = (seen[..., 2] > NEAREST) & ((places > 0) & (places < size)).all(-1)
        inside[:, view] = False
        found = functional.grid_sample(
            surfaces,
            (places / size * 2 - 1).flatten(0, 1)[:, None],
            padding_mode="border",
            align_corners=False,
        ).view(batch, count, 2, -1)
        deeper = found[:, :, 0] - depth.log()
        weight = inside * found[:, :, 1] * torch.exp(-0.5 * (deeper / AGREEMENT).square())
        total = confidences[:, view].flatten(1) + weight.sum(1)
        changes.append(((weight * deeper).sum(1) / total).view(batch, height, width))
    return torch.stack(changes, dim=1)
