"""The rendering loss: squared error and LPIPS (Eq. 4)."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.objectives.lpips import Lpips


@dataclass(frozen=True)
class RenderingLoss:
    """How far renders are from photos."""

    total: Float[Tensor, ""]
    """mse + lpips_weight * lpips."""
    mse: Float[Tensor, ""]
    lpips: Float[Tensor, ""]
    """0 when its weight is 0."""


def rendering_loss(
    predicted: Float[Tensor, "*batch 3 height width"],
    target: Float[Tensor, "*batch 3 height width"],
    *,
    lpips: Lpips | None = None,
    lpips_weight: float = 0.0,
) -> RenderingLoss:
    """MSE + lpips_weight * LPIPS, means over all images (paper: weight 0.05).

    The squared error is in float32; LPIPS runs under the caller's autocast. Renders are not clamped
    for the squared error, so that too bright ones keep a gradient; for LPIPS they are.

    Raises:
        ValueError: lpips_weight is above 0 and there is no LPIPS network.
    """
    if lpips_weight > 0 and lpips is None:
        raise ValueError(
            f"lpips_weight={lpips_weight} needs the LPIPS network: load it with "
            "objectives.lpips.load_lpips, or set lpips_weight to 0"
        )
    with torch.autocast(predicted.device.type, enabled=False):
        predicted, target = predicted.float(), target.float()
        mse = (predicted - target).square().mean()
        if lpips is None or lpips_weight <= 0:
            return RenderingLoss(mse, mse, torch.zeros_like(mse))
    distance = lpips(predicted.clamp(0, 1).flatten(0, -4), target.flatten(0, -4)).mean()
    return RenderingLoss(mse + lpips_weight * distance, mse, distance)
