"""Sub-cell positions of the best match of each descriptor cell."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.geometry.cameras import pixel_centers

MATCH_STRIDE = 4
"""Pixels between neighbouring descriptors."""
PEAK_ERROR_PX = 0.67
"""Standard deviation of a peak that is taken as independent of its neighbours. Real errors are
larger but correlate between neighbours; `BundleNoise.independence` accounts for that."""


@dataclass(frozen=True)
class Matches:
    """Matches of the cells of one view in another. Pixels are x, y."""

    centers: Float[Tensor, "cell 2"]
    """Centres of the cells, in pixels of their own view."""
    pixels: Float[Tensor, "batch cell 2"]
    """Position of the match in the other view."""
    precision: Float[Tensor, "batch cell 2 2"]
    """Inverse covariance of `pixels`, 1 / pixel^2."""
    confidence: Float[Tensor, "batch cell"]
    """Probability that the match is right."""

    def at(self, cells: Int[Tensor, " chosen"]) -> "Matches":
        """The matches of some cells."""
        return replace(
            self,
            centers=self.centers[cells],
            pixels=self.pixels[:, cells],
            precision=self.precision[:, cells],
            confidence=self.confidence[:, cells],
        )

    def split(self, parts: int) -> "list[Matches]":
        """The inverse of `join_matches`, for parts of equal batches."""
        values = (self.pixels, self.precision, self.confidence)
        rows = zip(*(value.chunk(parts) for value in values), strict=True)
        return [Matches(self.centers, *row) for row in rows]


def join_matches(parts: Sequence[Matches]) -> Matches:
    """Matches of the same cells, concatenated along the batch."""
    return Matches(
        centers=parts[0].centers,
        pixels=torch.cat([part.pixels for part in parts]),
        precision=torch.cat([part.precision for part in parts]),
        confidence=torch.cat([part.confidence for part in parts]),
    )


def cell_centers(rows: int, columns: int, *, like: Tensor) -> Float[Tensor, "cell 2"]:
    """Centres of the cells in pixels, row-major."""
    return pixel_centers(rows, columns, like=like).flatten(0, 1) * MATCH_STRIDE


def find_peaks(
    logits: Float[Tensor, "batch cell other"],
    total: Float[Tensor, "batch cell"],
    columns: int,
    radius: int = 2,
) -> Matches:
    """Expected position of each cell's match within a window around its best match.

    The mean gives sub-cell positions; the window keeps other modes from shifting it. The confidence
    is the probability mass in the window.

    Args:
        logits: Match logits of each cell against each cell of the other view, of the same size.
        total: Logarithm of the sum of their exponentials, as NanoBackbone.match gives it.
        columns: Columns of cells in a view.
        radius: Cells on each side of the best match.
    """
    rows = logits.shape[-1] // columns
    best = logits.argmax(dim=-1, keepdim=True)
    reach = torch.arange(-radius, radius + 1, device=logits.device)
    row = best // columns + reach.repeat_interleave(len(reach))
    column = best % columns + reach.repeat(len(reach))
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    cells = row.clamp(0, rows - 1) * columns + column.clamp(0, columns - 1)
    window = (logits.gather(-1, cells) - total[..., None]).exp() * inside
    confidence = window.sum(-1)
    centers = cell_centers(rows, columns, like=logits)
    pixels = (centers[cells] * window[..., None]).sum(-2) / confidence.clamp_min(1e-9)[..., None]
    precision = torch.eye(2).to(logits) / PEAK_ERROR_PX**2
    precision = precision.expand(*confidence.shape, 2, 2)
    return Matches(centers[: logits.shape[1]], pixels, precision, confidence)
