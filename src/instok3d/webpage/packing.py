"""Gaussians as the bytes that gaussians.js unpacks."""

import base64
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Num

from instok3d.types import Gaussians

Kind = Literal["float32", "float16", "int16", "int8"]


@dataclass(frozen=True)
class PackedArray:
    """One array of the bytes; it begins at a multiple of 4."""

    name: str
    type: Kind
    length: int
    scale: float = 1.0
    """Integers are multiples of it."""


@dataclass(frozen=True)
class PackedGaussians:
    """All arrays one after the other."""

    layout: tuple[PackedArray, ...]
    base64: str
    coefficients: int
    """Of the spherical harmonics that were kept: 1, 4, 9 or 16."""


def pack(gaussians: Gaussians, coefficients: int) -> PackedGaussians:
    """Unbatched Gaussians in their order.

    Centres keep single precision; half precision or less is enough for the rest: steps of
    1 / 32,767 in quaternions, and of 1 / 127 of the largest coefficient in the view-dependent
    colours.

    Args:
        gaussians: Unbatched.
        coefficients: How many of each Gaussian's are kept, from the constant one on.
    """
    plain = gaussians.map(lambda value: value.detach().cpu())
    sh = plain.sh.numpy()[:, :coefficients]
    columns: list[tuple[str, Kind, np.ndarray]] = [
        ("means", "float32", plain.means.numpy()),
        ("scales", "float32", plain.scales.numpy()),
        ("quats", "int16", plain.quats.numpy()),
        ("opacities", "float16", plain.opacities.numpy()),
        ("sh_constant", "float16", sh[:, 0]),
        ("sh_others", "int8", sh[:, 1:]),
    ]
    layout, chunks = [], []
    for name, kind, values in columns:
        stored, scale = _stored(values, kind)
        layout.append(PackedArray(name, kind, stored.size, scale))
        data = stored.tobytes()
        chunks.append(data + bytes(-len(data) % 4))
    return PackedGaussians(
        tuple(layout), base64.b64encode(b"".join(chunks)).decode("ascii"), coefficients
    )


def _stored(
    values: Num[np.ndarray, "*shape"], kind: Kind
) -> tuple[Num[np.ndarray, "*shape"], float]:
    """The values as they are stored, little-endian, and what integers are multiples of."""
    if kind == "float32":
        return np.ascontiguousarray(values, "<f4"), 1.0
    if kind == "float16":
        return np.ascontiguousarray(np.clip(values, -65504, 65504), "<f2"), 1.0
    most = 32767 if kind == "int16" else 127
    scale = float(np.abs(values).max(initial=0.0)) / most or 1.0
    return np.round(values / scale).astype("<i2" if kind == "int16" else "i1"), scale
