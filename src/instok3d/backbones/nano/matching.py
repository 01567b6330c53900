"""Where the best match of each descriptor cell lies, finer than the cells."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.geometry.cameras import pixel_centers

MATCH_STRIDE = 4
"""Pixels between neighbouring descriptors."""
PEAK_ERROR_PX = 0.67
"""How far a peak is taken to lie from its place; what it is wrong by more, neighbours share."""


@dataclass(frozen=True)
class Matches:
    """Where another view sees cells of a view. Pixels: x, y, the first pixel's centre at 0.5."""

    centers: Float[Tensor, "cell 2"]
    """The cells, in pixels of their own view."""
    pixels: Float[Tensor, "batch cell 2"]
    """In the other view."""
    precision: Float[Tensor, "batch cell 2 2"]
    """Inverse covariance of `pixels`, 1 / pixel^2."""
    trust: Float[Tensor, "batch cell"]
    """Probability that the match is right at all."""

    def at(self, cells: Int[Tensor, " chosen"]) -> "Matches":
        """Those of some cells alone."""
        return replace(
            self,
            centers=self.centers[cells],
            pixels=self.pixels[:, cells],
            precision=self.precision[:, cells],
            trust=self.trust[:, cells],
        )


def join_matches(parts: Sequence[Matches]) -> Matches:
    """One batch of all parts, which are of the same cells."""
    return Matches(
        centers=parts[0].centers,
        pixels=torch.cat([part.pixels for part in parts]),
        precision=torch.cat([part.precision for part in parts]),
        trust=torch.cat([part.trust for part in parts]),
    )


def cell_centers(rows: int, columns: int, *, like: Tensor) -> Float[Tensor, "cell 2"]:
    """Pixels in the middle of the cells, row-major."""
    return pixel_centers(rows, columns, like=like).flatten(0, 1) * MATCH_STRIDE


def find_peaks(
    logits: Float[Tensor, "batch cell other"],
    total: Float[Tensor, "batch cell"],
    columns: int,
    radius: int = 2,
) -> Matches:
    """The mean place over the window of cells around the best match of each cell.

    It lies between cells, and other modes far away do not draw it aside.

    Args:
        logits: Of each cell to lie at each cell of the other view, which is of the same size.
        total: Logarithm of the sum of the exponentials, as NanoBackbone.match gives it.
        columns: Of the cells of a view.
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
    centers = cell_centers(rows, columns, like=logits)
    pixels = (centers[cells] * window[..., None]).sum(-2) / trust.clamp_min(1e-9)[..., None]
    precision = torch.eye(2).to(logits) / PEAK_ERROR_PX**2
    return Matches(centers[: logits.shape[1]], pixels, precision.expand(*trust.shape, 2, 2), trust)
