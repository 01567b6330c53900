"""Cameras as the lists of numbers that JSON files hold, checked."""

import reprlib
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.checks import ROTATION_TOLERANCE, check_intrinsics, rigid_fault
from instok3d.reading import number

MARGIN = 1.0
"""How far outside its picture a principal point may lie, in sides: views may be parts of photos."""


def read_pose(
    value: Any, *, where: str, tolerance: float = ROTATION_TOLERANCE
) -> Float[Tensor, "4 4"]:
    """A rigid transform in float64.

    Args:
        value: Four lists of four numbers.
        where: File and camera, the subject of the message.
        tolerance: See `check_rigid`.

    Raises:
        ValueError: It is no such table, or no rigid transform.
    """
    pose = _matrix(value, 4, f"{where} has a pose that is")
    if fault := rigid_fault(pose, tolerance=tolerance):
        raise ValueError(f"{where} {fault}; give a rotation and a translation")
    return pose


def read_intrinsics(value: Any, *, where: str, height: int, width: int) -> Float[Tensor, "3 3"]:
    """Intrinsics in float64, in pixels of a picture of that size.

    Args:
        value: Three lists of three numbers.
        where: File and camera, the subject of the message.
        height: Of the picture.
        width: Likewise.

    Raises:
        ValueError: It is no such table, or of no pinhole camera of such a picture.
    """
    intrinsics = _matrix(value, 3, f"{where} has intrinsics that are")
    check_intrinsics(intrinsics, where=where, height=height, width=width, margin=MARGIN)
    return intrinsics


def _matrix(value: Any, size: int, what: str) -> Float[Tensor, "{size} {size}"]:
    rows = value if isinstance(value, list) and len(value) == size else []
    if not rows or not all(isinstance(row, list) and len(row) == size for row in rows):
        raise ValueError(f"{what} not {size} x {size} numbers: {reprlib.repr(value)}")
    try:
        return torch.tensor([[number(each) for each in row] for row in rows], dtype=torch.float64)
    except ValueError as error:
        raise ValueError(f"{what} not {size} x {size} numbers: {error}") from error
