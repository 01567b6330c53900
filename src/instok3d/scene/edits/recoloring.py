"""Another colour for Gaussians, with the light and dark that was on them."""

from collections.abc import Sequence
from dataclasses import replace

import torch

from instok3d.geometry.spherical_harmonics import SH_CONSTANT
from instok3d.types import Gaussians

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Of linear sRGB; used on coded values, as a measure of light and dark."""
DARKEST = 0.02
"""Mean luminance below which an object has no shading that a new colour could keep."""


def recolored(gaussians: Gaussians, color: Sequence[float]) -> Gaussians:
    """Gaussians in one hue whose mean is a colour and whose luminance varies as it did.

    The colour of each becomes luminance / mean luminance x `color`, in every direction; what has
    hardly any luminance gets the colour without shading.

    Args:
        gaussians: Unbatched.
        color: SRGB in [0, 1].
    """
    sh = gaussians.sh.double()
    target = torch.tensor(color, dtype=torch.float64)
    luminance = sh @ torch.tensor(LUMINANCE, dtype=torch.float64)
    luminance[:, 0] += 0.5 / SH_CONSTANT  # of the colour itself, not of its distance from grey
    weights = gaussians.opacities.double().clamp_min(1e-6)
    mean = float((weights * luminance[:, 0]).sum() / weights.sum()) * SH_CONSTANT
    if mean < DARKEST:
        luminance = torch.zeros_like(luminance)
        luminance[:, 0], mean = 1 / SH_CONSTANT, 1.0
    tinted = luminance[..., None] / mean * target
    tinted[:, 0] -= 0.5 / SH_CONSTANT
    return replace(gaussians, sh=tinted.to(gaussians.sh.dtype))
