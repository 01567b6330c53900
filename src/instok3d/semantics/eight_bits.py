"""Weights of small networks in files: matrices in 8 bits with a scale a row, the rest in 16."""

from collections.abc import Mapping

import torch
from jaxtyping import Float, Int8
from torch import Tensor

SCALES = ".scales"
"""Behind the name of a matrix: the size of a step of each of its rows."""


def narrowed(weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Weights as they are stored: int8 with float32 scales, or float16.

    Raises:
        ValueError: A weight is not finite, in float16 where it is stored so.
    """
    stored: dict[str, Tensor] = {}
    for name, value in weights.items():
        if value.ndim > 1:
            stored[name], stored[name + SCALES] = rounded(value)
        else:
            stored[name] = value.half()
        if not value.isfinite().all() or not stored[name].isfinite().all():
            raise ValueError(f"weight {name} is not finite in float16")
    return {name: value.contiguous() for name, value in stored.items()}


def widened(stored: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The weights again, float32.

    Raises:
        KeyError: A matrix has no scales.
        ValueError: A weight is not finite.
    """
    weights = {}
    for name, value in stored.items():
        if name.endswith(SCALES):
            continue
        whole = value.float()
        if value.dtype == torch.int8:
            whole = whole * stored[name + SCALES].view(-1, *[1] * (value.ndim - 1))
        if not whole.isfinite().all():
            raise ValueError(f"weight {name} is not finite")
        weights[name] = whole
    return weights


def rounded(
    values: Float[Tensor, "row *column"],
) -> tuple[Int8[Tensor, "row *column"], Float[Tensor, " row"]]:
    """Each row in 127 steps of its largest value, and the size of a step."""
    flat = values.detach().float().flatten(1)
    scales = flat.abs().amax(dim=1).clamp_min(1e-9) / 127
    return (flat / scales[:, None]).round().to(torch.int8).view(values.shape), scales
