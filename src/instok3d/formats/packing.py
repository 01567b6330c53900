"""Numbers packed into few bits, as several splat formats do, and files that are compressed."""

import zlib
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

SPREAD, SPARE_BYTES = 32, 2**22
"""A compressed file may grow to SPREAD times its size and SPARE_BYTES; splats shrink to a half or
a third, so that more is a bomb."""


def check_growth(path: Path, inflated: int) -> None:
    """Refuse a file that would grow to many times its size.

    Raises:
        ValueError: It would.
    """
    have = path.stat().st_size
    if inflated > SPREAD * have + SPARE_BYTES:
        raise ValueError(
            f"{path}: its {have:,} bytes promise {inflated:,} bytes of Gaussians, more than any "
            "such file holds; it is damaged"
        )


def gunzip_start(data: bytes, length: int) -> bytes:
    """The first bytes of a gzip stream, fewer where it is shorter.

    Raises:
        zlib.error: It is none.
    """
    return zlib.decompressobj(zlib.MAX_WBITS | 16).decompress(data, length)


def to_unsigned(values: Float[np.ndarray, "*shape"], most: int) -> Int[np.ndarray, "*shape"]:
    """Values in [0, 1] as whole numbers in 0..most, rounded; others are clamped."""
    return np.rint(np.clip(values, 0, 1) * most).astype(np.int64)


def smallest_three(
    quats: Float[np.ndarray, "row 4"],
) -> tuple[Int[np.ndarray, " row"], Float[np.ndarray, "row 3"]]:
    """The column of each row's largest component, and the other three, in order.

    They have the sign at which the largest is positive; each lies within 1 / sqrt(2) of 0.
    """
    largest = np.abs(quats).argmax(axis=1)
    own = np.take_along_axis(quats, largest[:, None], axis=1)
    others = np.arange(3)[None] + (np.arange(3)[None] >= largest[:, None])
    return largest, np.take_along_axis(quats, others, axis=1) * np.where(own < 0, -1, 1)


def from_smallest_three(
    largest: Int[np.ndarray, " row"], three: Float[np.ndarray, "row 3"]
) -> Float[np.ndarray, "row 4"]:
    """Undo `smallest_three`."""
    quats = np.empty((len(three), 4), np.float32)
    others = np.arange(3)[None] + (np.arange(3)[None] >= largest[:, None])
    np.put_along_axis(quats, others, three.astype(np.float32), axis=1)
    missing = np.sqrt(np.maximum(0, 1 - np.square(three).sum(axis=1)))
    np.put_along_axis(quats, largest[:, None], missing[:, None].astype(np.float32), axis=1)
    return quats
