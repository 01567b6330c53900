"""The colours of a flat surface where no view shows it: a membrane, and a repeated pattern."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

SWEEPS = 60
"""Of relaxation on each level."""
RIM = 8
"""Cells around what is wanted that a copy is compared with."""
UNLIKE = 1.0
"""Mean square of what a copy is off at the rim, over the variance there; unrelated ones have 2."""
MIN_RIM = 40
"""Cells of the rim that must be known."""
MIN_OVERLAP = 0.5
"""Share of the rim, and of what is wanted, that a copy must have."""


def smoothly_filled(
    values: Float[Tensor, "channel row column"], known: Bool[Tensor, "row column"]
) -> Float[Tensor, "channel row column"]:
    """Values everywhere: the known ones, and between them the harmonic function (a membrane).

    From coarse to fine: halved grids are filled first and are where the finer ones begin.
    """
    if known.all() or not known.any():
        return values
    height, width = known.shape
    weights = known[None].to(values)
    if min(height, width) > 2:
        pool = torch.nn.functional.avg_pool2d
        small = pool(weights, 2, ceil_mode=True)
        coarse = pool(values * weights, 2, ceil_mode=True) / small.clamp_min(1e-6)
        coarse = smoothly_filled(coarse, small[0] > 0)
        begun = torch.nn.functional.interpolate(
            coarse[None], scale_factor=2, mode="bilinear", align_corners=False
        )[0][:, :height, :width]
    else:
        begun = (values * weights).sum((1, 2), keepdim=True) / weights.sum()
    filled = torch.where(known, values, begun)
    for _ in range(SWEEPS):
        padded = torch.nn.functional.pad(filled[None], (1, 1, 1, 1), mode="replicate")[0]
        mean = (
            padded[:, :-2, 1:-1] + padded[:, 2:, 1:-1] + padded[:, 1:-1, :-2] + padded[:, 1:-1, 2:]
        ) / 4
        filled = torch.where(known, values, mean)
    return filled


def continued(
    values: Float[Tensor, "channel row column"],
    known: Bool[Tensor, "row column"],
    wanted: Bool[Tensor, "row column"],
) -> Float[Tensor, "channel row column"]:
    """Values everywhere, with the pattern of the known ones where it repeats itself.

    1. The shift is looked for that takes the rim of what is wanted to known cells that look alike,
       and most of what is wanted to known cells.
    2. Where it is like the rim (UNLIKE), wanted cells are copies from there, and what the copy is
       off at the rim is added to them as a membrane.
    3. Otherwise, and for cells whose copy is not known, the values are the membrane alone.

    Args:
        values: Any where they are not known.
        known: Of the cells.
        wanted: The cells to be filled; known ones are rim, not filled.
    """
    smooth = smoothly_filled(values, known)
    wanted = wanted & ~known
    shift = _best_shift(values, smooth, known, wanted)
    if shift is None:
        return smooth
    moved = [torch.roll(each, shift, dims=(-2, -1)) for each in (values, known)]
    copied, there = moved[0], moved[1] & _inside(known, shift)
    off = smoothly_filled(values - copied, known & there)
    return torch.where(known | ~there, smooth, copied + off)


def _best_shift(
    values: Float[Tensor, "channel row column"],
    smooth: Float[Tensor, "channel row column"],
    known: Bool[Tensor, "row column"],
    wanted: Bool[Tensor, "row column"],
) -> tuple[int, int] | None:
    """How far copies come from, down and to the right; None where no copy fits well enough."""
    grown = torch.nn.functional.max_pool2d(wanted[None].float(), 2 * RIM + 1, 1, RIM)[0] > 0
    rim = (grown & known).double()
    sources, targets = known.double(), wanted.double()
    if float(rim.sum()) < MIN_RIM or float(sources.sum()) < float(targets.sum()):
        return None
    v = values.double() * sources
    # Sums over the rim of (v(x) - v(x - shift))^2, for all shifts at once.
    apart = (
        _correlated(rim * (v**2).sum(0), sources)
        - 2 * sum(_correlated(rim * each, each) for each in v)
        + _correlated(rim, (v**2).sum(0))
    )
    overlap, covered = _correlated(rim, sources), _correlated(targets, sources)
    usable = (overlap > MIN_OVERLAP * rim.sum()) & (covered > MIN_OVERLAP * targets.sum())
    if not usable.any():
        return None
    cost = torch.where(usable, apart / overlap.clamp_min(1), torch.inf)
    mean = (rim * v).sum((1, 2), keepdim=True) / rim.sum()
    variance = float((rim * ((v - mean) ** 2).sum(0)).sum() / rim.sum())
    best = int(cost.argmin())
    if float(cost.flatten()[best]) > variance * UNLIKE:
        return None
    rows, columns = cost.shape
    down, right = best // columns, best % columns
    return (
        down - rows if down > rows // 2 else down,
        right - columns if right > columns // 2 else right,
    )


def _correlated(
    first: Float[Tensor, "row column"], second: Float[Tensor, "row column"]
) -> Float[Tensor, "lag_row lag_column"]:
    """Sum over x of first(x) second(x - shift) by shift; negative ones count from the end."""
    rows, columns = first.shape
    size = (2 * rows, 2 * columns)
    product = torch.fft.rfft2(first, size) * torch.fft.rfft2(second, size).conj()
    return torch.fft.irfft2(product, size)


def _inside(mask: Bool[Tensor, "row column"], shift: tuple[int, int]) -> Bool[Tensor, "row column"]:
    """Cells whose copies do not come from beyond the border."""
    rows, columns = mask.shape
    down, right = shift
    y, x = torch.arange(rows)[:, None] - down, torch.arange(columns)[None] - right
    return (y >= 0) & (y < rows) & (x >= 0) & (x < columns)
