"""Exposure and white balance of each photo, fitted beside the Gaussians."""

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.refinement.adam import Adam


class Exposure:
    """photo = gain * render + offset, for each photo and colour.

    The gains' logarithms and the offsets are 0 in the mean over the photos, so that the scene
    keeps the brightness that the photos have together: one photo alone changes nothing.
    """

    def __init__(self, views: int, *, rate: float, device: torch.device) -> None:
        self.log_gains = torch.zeros(views, 3, 1, 1, device=device, requires_grad=True)
        self.offsets = torch.zeros(views, 3, 1, 1, device=device, requires_grad=True)
        self._optimizer = Adam([(self.log_gains, rate), (self.offsets, rate)], eps=1e-8)

    def applied(
        self, renders: Float[Tensor, "view 3 height width"], views: list[int]
    ) -> Float[Tensor, "view 3 height width"]:
        """Renders as the cameras of these photos would have exposed them."""
        return renders * self.log_gains[views].exp() + self.offsets[views]

    def step(self) -> None:
        """One step of Adam along the gradients, which are cleared; the means are held."""
        self._optimizer.step()
        with torch.no_grad():
            for value in (self.log_gains, self.offsets):
                value -= value.mean(dim=0, keepdim=True)
