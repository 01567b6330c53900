"""Gaussians that float where another view looks through.

Depth bleeds at the rims of things: points hang between them and what lies behind. One view cannot
tell, and in its own picture they hide nothing; from aside they cover what is there. Another view
that sees a surface farther away on the same ray says that nothing is there. Not in the paper.
"""

from dataclasses import replace

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from instok3d.geometry.cameras import transform_points
from instok3d.types import Gaussians, Geometry, TokenGroups

IN_FRONT = 0.04
"""A surface has to be farther than a Gaussian by this share of its depth to say so."""
RIM_PX = 1
"""Every surface within so many pixels has to be; at rims a ray may pass on either side."""
KEPT = 0.3
"""What each view that looks through leaves of the opacity."""
NEAREST = 1e-6
"""Depth, scene units, at which a Gaussian counts as behind a camera."""


def thin_out_free_space(groups: TokenGroups) -> TokenGroups:
    """The scene with less opacity for each Gaussian, the more views see through it.

    The view that a Gaussian comes from is not asked. In float32, also under autocast.
    Differentiable in the opacities, not in which views see through.
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
    """How many views other than its own see a surface behind the place of each Gaussian.

    Args:
        gaussians: In the frame and units of the geometry.
        source: The view that each one comes from.
        geometry: Depth and cameras of all views.
    """
    _, count, height, width = geometry.depths.shape
    # The nearest surface about each pixel.
    nearest = -functional.max_pool2d(-geometry.depths.float(), 2 * RIM_PX + 1, 1, RIM_PX)
    through = torch.zeros_like(gaussians.opacities, dtype=torch.float32)
    size = torch.tensor([width, height], device=source.device)
    for view in range(count):
        seen = transform_points(
            geometry.cameras.cam_from_world[:, view].float(), gaussians.means.float()
        )
        depth = seen[..., 2]
        front = depth > NEAREST
        places = seen @ geometry.cameras.intrinsics[:, view].float().mT
        # Behind the camera or far outside: any place, which is not asked for.
        places = places[..., :2] / depth.clamp_min(NEAREST)[..., None]
        inside = front & ((places >= 0) & (places < size)).all(-1)
        pixels = torch.where(inside[..., None], places, 0).long()
        surface = nearest[:, view].flatten(1).gather(1, pixels[..., 1] * width + pixels[..., 0])
        looked_through = inside & (depth < (1 - IN_FRONT) * surface) & (source != view)
        through += looked_through
    return through
