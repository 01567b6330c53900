"""Free-space pruning: Gaussians that other views see through lose opacity. Not in the paper.

Predicted depth is smeared at depth discontinuities: points float between an object and what lies
behind it. In the view that they come from they hide nothing; from another viewpoint they cover
what is there. A view that observes a surface farther away along the same ray contradicts them.
"""

from dataclasses import replace

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from instok3d.geometry.cameras import transform_points
from instok3d.types import Gaussians, Geometry, TokenGroups

IN_FRONT = 0.04
"""A Gaussian is contradicted if it is nearer than the surface by this share of its depth."""
DISCONTINUITY_PX = 1
"""All depths within so many pixels must lie behind the Gaussian: near a depth discontinuity the
ray may hit either side."""
KEPT = 0.3
"""Factor on the opacity for each view that sees through."""
NEAREST = 1e-6
"""Depth in scene units below which a Gaussian counts as behind the camera."""


def prune_free_space(groups: TokenGroups) -> TokenGroups:
    """The scene with every opacity multiplied by KEPT for each view that sees through it.

    The view that a Gaussian comes from does not count. Runs in float32, also under autocast.
    Differentiable in the opacities, not in the number of views.
    """
    with torch.autocast(groups.geometry.depths.device.type, enabled=False):
        per_view = groups.geometry.features.shape[2]
        source = (groups.anchors.patches // per_view).gather(1, groups.gaussians.anchor_index)
        through = count_seen_through(groups.gaussians, source, groups.geometry)
        opacities = groups.gaussians.opacities * KEPT**through
    return replace(groups, gaussians=replace(groups.gaussians, opacities=opacities))


@torch.no_grad()
def count_seen_through(
    gaussians: Gaussians, source: Int[Tensor, "batch gaussian"], geometry: Geometry
) -> Float[Tensor, "batch gaussian"]:
    """The number of views, other than its own, that observe a surface behind each Gaussian.

    Args:
        gaussians: In the frame and units of the geometry.
        source: The view that each one comes from.
        geometry: Depth and cameras of all views.
    """
    _, count, height, width = geometry.depths.shape
    # Minimum filter: the nearest surface around each pixel.
    nearest = -functional.max_pool2d(
        -geometry.depths.float(), 2 * DISCONTINUITY_PX + 1, 1, DISCONTINUITY_PX
    )
    through = torch.zeros_like(gaussians.opacities, dtype=torch.float32)
    size = torch.tensor([width, height], device=source.device)
    for view in range(count):
        seen = transform_points(
            geometry.cameras.cam_from_world[:, view].float(), gaussians.means.float()
        )
        depth = seen[..., 2]
        front = depth > NEAREST
        places = seen @ geometry.cameras.intrinsics[:, view].float().mT
        # Behind the camera or far outside: any pixel will do, `inside` masks it.
        places = places[..., :2] / depth.clamp_min(NEAREST)[..., None]
        inside = front & ((places >= 0) & (places < size)).all(-1)
        pixels = torch.where(inside[..., None], places, 0).long()
        surface = nearest[:, view].flatten(1).gather(1, pixels[..., 1] * width + pixels[..., 0])
        looked_through = inside & (depth < (1 - IN_FRONT) * surface) & (source != view)
        through += looked_through
    return through
