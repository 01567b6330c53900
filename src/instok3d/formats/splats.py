"""What a reader of splat files returns, and what of a file can be drawn."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from instok3d.geometry.moving import move_gaussians
from instok3d.types import MAX_LENGTH, Gaussians

SCALES = (torch.finfo(torch.float32).tiny, MAX_LENGTH)
"""What scales are kept within. Others write flat Gaussians with scale 0, whose logarithm is
infinite."""
LOGIT_LIMIT = 80.0
"""Infinite logits are read as this one, which single precision cannot tell from 0 or 1 either."""


@dataclass(frozen=True)
class Splats:
    """Gaussians from a file, with the groups that it tells of."""

    gaussians: Gaussians
    """Unbatched, on the CPU, in the file's order and, unless its reader says otherwise, in the
    file's own axes; anchor_index is all 0."""
    object_ids: Int[Tensor, " gaussian"]
    """The group of each Gaussian, 0 for those of none; all 0 where the file has no groups."""
    labels: Mapping[int, str] = field(default_factory=dict)
    """Names of groups, by the numbers in object_ids."""
    up: tuple[float, float, float] | None = None
    """The up direction that the file states, of length 1; None where it states none."""
    units: Literal["metres", "arbitrary"] = "arbitrary"
    """Of all lengths, as the file states them."""
    notes: tuple[str, ...] = ()
    """What was left out or changed, one sentence each."""

    def moved(self, to_from: Float[Tensor, "4 4"]) -> "Splats":
        """The same in the frame that a rigid transform leads to; `up` is turned too."""
        up = self.up
        if up is not None:
            x, y, z = (to_from[:3, :3] @ torch.tensor(up)).tolist()
            up = (x, y, z)
        return replace(self, gaussians=move_gaussians(self.gaussians, to_from), up=up)


def drawable_splats(
    file: Path,
    *,
    means: Float[Tensor, "gaussian 3"],
    quats: Float[Tensor, "gaussian 4"],
    scales: Float[Tensor, "gaussian 3"],
    opacities: Float[Tensor, " gaussian"],
    sh: Float[Tensor, "gaussian coefficient 3"],
    object_ids: Int[Tensor, " gaussian"] | None = None,
    up: tuple[float, float, float] | None = None,
    units: Literal["metres", "arbitrary"] = "arbitrary",
    notes: tuple[str, ...] = (),
) -> Splats:
    """The Gaussians of a file without those that cannot be drawn, each within bounds.

    Args:
        file: Where they come from.
        means: Float32, any values.
        quats: Wxyz, of any length but 0.
        scales: Standard deviations; capped to SCALES.
        opacities: Capped to [0, 1].
        sh: 1, 4, 9 or 16 coefficients.
        object_ids: Of each Gaussian; 0 where it is None.
        up: See `Splats`.
        units: See `Splats`.
        notes: What the reader changed already.

    Returns:
        The splats; their notes count the dropped Gaussians: with numbers that are not finite,
        centres beyond MAX_LENGTH, or quaternions of length 0.
    """
    if object_ids is None:
        object_ids = torch.zeros(len(means), dtype=torch.long)
    # Longest entry first: squares of small ones vanish, and those of large ones overflow.
    longest = quats.abs().amax(dim=1)
    rows = (means.abs() <= MAX_LENGTH).all(dim=1) & (longest > 0) & longest.isfinite()
    rows &= ~scales.isnan().any(dim=1) & ~opacities.isnan()
    for coefficient in range(sh.shape[1]):  # not all at once: sh is most of the memory
        rows &= sh[:, coefficient].isfinite().all(dim=1)
    if not rows.all():
        notes = (*notes, _dropped(file, rows))
        means, quats, scales, opacities, sh, object_ids, longest = (
            value[rows] for value in (means, quats, scales, opacities, sh, object_ids, longest)
        )
    gaussians = Gaussians(
        means=means,
        quats=torch.nn.functional.normalize(quats / longest[:, None], dim=1),
        scales=scales.clamp(*SCALES),
        opacities=opacities.clamp(0, 1),
        sh=sh,
        anchor_index=torch.zeros(len(means), dtype=torch.long),
    )
    return Splats(gaussians, object_ids, up=up, units=units, notes=notes)


def _dropped(file: Path, kept: Bool[Tensor, " gaussian"]) -> str:
    return (
        f"{file}: dropped {int((~kept).sum())} Gaussians that cannot be drawn: with numbers that "
        f"are not finite or beyond {MAX_LENGTH:.0e}, or a quaternion of length 0"
    )
