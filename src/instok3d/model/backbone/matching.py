"""Where the best match of each descriptor cell lies, finer than the cells."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True)
class Peaks:
    """The cells around the best match of each cell, with their shares."""

    cells: Int[Tensor, "batch cell window"]
    shares: Float[Tensor, "batch cell window"]
    """Sum to 1."""
    trust: Float[Tensor, "batch cell"]
    """Probability that the match lies in the window."""

    def mean(
        self, values: Float[Tensor, "batch other channel"]
    ) -> Float[Tensor, "batch cell channel"]:
        """Mean of the values of the other view's cells, weighted by the shares."""
        chosen = values.gather(1, self.cells.flatten(1)[..., None].expand(-1, -1, values.shape[-1]))
        return (chosen.unflatten(1, self.cells.shape[1:]) * self.shares[..., None]).sum(-2)


def find_peaks(
    logits: Float[Tensor, "batch cell other"],
    total: Float[Tensor, "batch cell"],
    columns: int,
    radius: int = 2,
) -> Peaks:
    """The window of cells around the best match of each cell.

    The mean over a window lies between cells, and other modes far away do not draw it aside.

    Args:
        logits: Of each cell to lie at each cell of the other view.
        total: Logarithm of the sum of the exponentials, as NanoBackbone.match gives it.
        columns: Of the other view's cells.
        radius: Cells on each side of the best one.
    """
    rows = logits.shape[-1] // columns
    best = logits.argmax(dim=-1, keepdim=True)
    reach = torch.arange(-radius, radius + 1, device=logits.device)
    row = best // columns + reach.repeat_interleave(len(reach))
    column = best % columns + reach.repeat(len(reach))
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    cells = row.clamp(0, rows - 1) * columns + column.clamp(0, columns - 1)
    window = (logits.gather(-1, cells) - total[..., None]).exp() * inside
    trust = window.sum(-1)
    return Peaks(cells, window / trust.clamp_min(1e-9)[..., None], trust)
