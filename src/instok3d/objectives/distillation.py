"""The distillation loss: rendered features and shared features agree with 2D features (Eq. 8)."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional


@dataclass(frozen=True)
class DistillationLoss:
    """Both terms and their sum."""

    total: Float[Tensor, ""]
    pixels: Float[Tensor, ""]
    """Mean of 1 - cos over the pixels."""
    groups: Float[Tensor, ""]
    """Mean of 1 - cos over the groups of the views; 0 where no view shows any."""


def distillation_loss(
    features: Float[Tensor, "batch view feature height width"],
    shares: Float[Tensor, "batch view group basis height width"],
    shared: Float[Tensor, "batch group basis feature"],
    teacher: Float[Tensor, "batch view feature height width"],
    *,
    min_pixels: float = 16.0,
) -> DistillationLoss:
    """How far lifted features are from those of a 2D teacher, as angles.

    Means take the place of the paper's sums over pixels, views and groups. In float32.

    1. Every pixel: its reconstructed feature against the teacher's.
    2. Every group in every view: its shared feature against the mean of the teacher's over the
       group's rendered mask. Where a group has several shared features, their mean by the mask.

    Args:
        features: F (Eq. 7).
        shares: S^, of which the mask is made without gradients.
        shared: s.
        teacher: Phi at the pixels of the maps.
        min_pixels: Groups with less mass in a view have no second term there.
    """
    wanted = teacher.float()
    pixels = (1 - functional.cosine_similarity(features.float(), wanted, dim=2)).mean()
    masks = shares.detach().float()
    mass = masks.sum(dim=(3, 4, 5))  # batch view group
    counted = mass >= min_pixels
    mean = torch.einsum("bvgkhw,bvdhw->bvgd", masks, wanted)
    basis = masks.sum(dim=(4, 5)) / mass.clamp_min(1e-6)[..., None]
    summary = torch.einsum("bvgk,bgkd->bvgd", basis, shared.float())
    away = 1 - functional.cosine_similarity(summary, mean, dim=-1)
    groups = away[counted].mean() if counted.any() else away.sum() * 0
    return DistillationLoss(pixels + groups, pixels, groups)
