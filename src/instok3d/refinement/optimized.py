"""The Gaussians of one scene while they are being optimised."""

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.refinement.parameters import GaussianParameters
from instok3d.refinement.settings import LearningRates
from instok3d.refinement.splitting import split_largest
from instok3d.types import Gaussians


class OptimizedGaussians:
    """Parameters with their anchors, their optimiser, and where their centres began.

    Args:
        gaussians: One scene; copied.
        rates: Of Adam.
        length: Scene units in one unit of the rate of the means, and of the pull.
    """

    def __init__(self, gaussians: Gaussians, rates: LearningRates, *, length: float) -> None:
        self._parameters = GaussianParameters.of(gaussians)
        self._anchor_index = gaussians.anchor_index
        self._start = self._parameters.means.clone()
        self._pressure = torch.zeros(len(self._start), device=self._start.device)
        self._rates, self._length = rates, length
        self._optimizer = self._parameters.optimizer(rates, length=length)

    def gaussians(self) -> Gaussians:
        """As they are now, differentiable in the parameters."""
        return self._parameters.gaussians(self._anchor_index)

    def pull(self) -> Float[Tensor, ""]:
        """Mean squared distance of the centres from where they began, in lengths."""
        moved = (self._parameters.means - self._start) / self._length
        return moved.square().sum(dim=1).mean()

    def step(self) -> None:
        """One step of Adam along the gradients, which are cleared."""
        assert self._parameters.means.grad is not None
        self._pressure += self._parameters.means.grad.norm(dim=1)
        self._optimizer.step()

    def split(self, share: float) -> None:
        """Split those that the photos have pulled at most (`split_largest`); Adam begins anew."""
        split = split_largest(self._parameters, self._pressure, share)
        self._parameters = split.parameters
        self._anchor_index = self._anchor_index[split.source]
        self._start = self._start[split.source] + split.moved
        self._pressure = self._pressure[split.source]
        self._optimizer = self._parameters.optimizer(self._rates, length=self._length)
