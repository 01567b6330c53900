"""Gaussians as unbounded parameters of an optimiser, and back."""

from dataclasses import dataclass, fields

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from instok3d.refinement.adam import Adam
from instok3d.refinement.settings import LearningRates
from instok3d.types import Flow, Gaussians

OPACITY_EDGE = 1e-4
"""Opacities are kept so far from 0 and 1, where logits are infinite."""


@dataclass(frozen=True)
class GaussianParameters(Flow):
    """`Gaussians` of one scene without bounds: every real number gives a Gaussian."""

    means: Float[Tensor, "gaussian 3"]
    log_scales: Float[Tensor, "gaussian 3"]
    quats: Float[Tensor, "gaussian 4"]
    """Of any length."""
    opacity_logits: Float[Tensor, " gaussian"]
    sh_constant: Float[Tensor, "gaussian 1 3"]
    sh_others: Float[Tensor, "gaussian coefficient 3"]

    @staticmethod
    def of(gaussians: Gaussians) -> "GaussianParameters":
        """Copies, without gradients' history; opacities of 0 and 1 move by OPACITY_EDGE."""
        opacities = gaussians.opacities.clamp(OPACITY_EDGE, 1 - OPACITY_EDGE)
        own = GaussianParameters(
            gaussians.means, gaussians.scales.log(), gaussians.quats, opacities.logit(),
            gaussians.sh[:, :1], gaussians.sh[:, 1:],
        )  # fmt: skip
        return own.map(lambda value: value.detach().float().clone())

    def gaussians(self, anchor_index: Int[Tensor, " gaussian"]) -> Gaussians:
        """The Gaussians, differentiable in the parameters."""
        return Gaussians(
            means=self.means,
            quats=functional.normalize(self.quats, dim=-1),
            scales=self.log_scales.exp(),
            opacities=self.opacity_logits.sigmoid(),
            sh=torch.cat([self.sh_constant, self.sh_others], dim=1),
            anchor_index=anchor_index,
        )

    def optimizer(self, rates: LearningRates, *, length: float) -> Adam:
        """Adam over all of them, which need gradients from now on.

        Args:
            rates: For each field, by its name.
            length: Scene units in one unit of the rate of the means.
        """
        rows = []
        for field in fields(self):
            value = getattr(self, field.name).requires_grad_()
            unit = length if field.name == "means" else 1.0
            rows.append((value, unit * getattr(rates, field.name)))
        return Adam(rows, eps=1e-15)
