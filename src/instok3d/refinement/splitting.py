"""Gaussians split in two where the error stays."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.geometry.rotations import quat_to_matrix
from instok3d.refinement.parameters import GaussianParameters

SHRINK = 1.6
"""By how much the halves are narrower along the axis that was split, as in 3DGS."""
APART = 0.5
"""How far each half stands from the middle, in standard deviations of the whole."""


@dataclass(frozen=True)
class Split:
    """Parameters after a split, and where each row came from."""

    parameters: GaussianParameters
    source: Int[Tensor, " gaussian"]
    """Row before the split; halves stand one after the other in the place of the whole."""
    moved: Float[Tensor, "gaussian 3"]
    """From the centre of the source, scene units; 0 where nothing was split."""


@torch.no_grad()
def split_largest(
    parameters: GaussianParameters,
    pressure: Float[Tensor, " gaussian"],
    share: float,
) -> Split:
    """Split the Gaussians that the photos pull at most, along their longest axis.

    The pull is the gradient of the centre summed over the steps, times the longest standard
    deviation: what a narrower Gaussian could gain. Halves have the colour and opacity of the
    whole; their centres stand APART on both sides.

    Args:
        parameters: One scene.
        pressure: Norms of the centres' gradients, summed over the steps.
        share: Of the Gaussians, that are split; none without pressure are.
    """
    count = len(parameters.means)
    longest = parameters.log_scales.max(dim=1)
    gain = pressure * longest.values.exp()
    number = min(int(share * count), int((gain > 0).sum()))
    chosen = torch.zeros(count, dtype=torch.bool, device=gain.device)
    chosen[gain.topk(number).indices] = True
    repeats = 1 + chosen.long()
    source = torch.arange(count, device=gain.device).repeat_interleave(repeats)
    first = torch.ones_like(source, dtype=torch.bool)
    first[1:] = source[1:] != source[:-1]
    sign = torch.where(chosen[source], torch.where(first, 1.0, -1.0), 0.0)
    rows = parameters.map(lambda value: value[source].clone())
    axis = longest.indices[source]
    direction = quat_to_matrix(rows.quats)[torch.arange(len(source)), :, axis]
    moved = direction * (sign * APART * longest.values.exp()[source])[:, None]
    rows.means.add_(moved)
    narrower = torch.zeros_like(rows.log_scales)
    narrower[torch.arange(len(source)), axis] = -torch.tensor(SHRINK).log()
    rows.log_scales.add_(narrower * chosen[source][:, None])
    return Split(rows, source, moved)
