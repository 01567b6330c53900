"""Whether a camera can be used: the one check behind every reader of cameras."""

import torch
from jaxtyping import Float
from torch import Tensor

ROTATION_TOLERANCE = 5e-3
"""Largest entry of |R R^T - I|: numbers rounded to three decimals pass, a shear does not."""
MAX_DISTANCE = 1e9
"""From the origin, any units. Fourth powers of it are still finite in single precision."""
MAX_SIDE = 10**6
"""Pixels; larger image sides are taken for damage."""
FOCAL_RANGE = (0.02, 1000.0)
"""Focal lengths in image sides: fields of view of 175 and 0.06 degrees. Intrinsics that are
normalised to an image of side 1 lie far outside."""
SKEW_TOLERANCE = 1e-3
"""In focal lengths: what a calibration may leave; the ray of a pixel ignores it."""
_ROUNDING = 1e-6


def check_rigid(
    matrix: Float[Tensor, "rows columns"], *, where: str, tolerance: float = ROTATION_TOLERANCE
) -> Float[Tensor, "4 4"]:
    """Refuse a transform that is not a rotation and a translation.

    Args:
        matrix: cam_from_world or world_from_cam.
        where: File and camera, the subject of the message.
        tolerance: Largest entry of |R R^T - I|.

    Returns:
        The nearest exactly rigid transform, in the dtype of the matrix.

    Raises:
        ValueError: It is not 4 x 4, not finite, not orthonormal, mirrored, has another last row
            than 0 0 0 1, or lies farther from the origin than MAX_DISTANCE.
    """
    fault = rigid_fault(matrix, tolerance=tolerance)
    if fault is not None:
        raise ValueError(
            f"{where} {fault}; wanted a rotation and a translation below {MAX_DISTANCE:.0e} units"
        )
    exact = matrix.double()
    u, _, vh = torch.linalg.svd(exact[:3, :3])
    return torch.cat(
        [torch.cat([u @ vh, exact[:3, 3:]], dim=1), exact.new_tensor([[0.0, 0.0, 0.0, 1.0]])]
    ).to(matrix.dtype)


def rigid_fault(
    matrix: Float[Tensor, "rows columns"], *, tolerance: float = ROTATION_TOLERANCE
) -> str | None:
    """Why a transform is not rigid, to follow the name of a camera; None where it is."""
    if matrix.shape != (4, 4):
        return f"has a pose of {_shape(matrix)} numbers instead of 4 x 4"
    matrix = matrix.double()
    if not matrix.isfinite().all():
        return "has a pose that is not finite"
    if (matrix[3] - matrix.new_tensor([0.0, 0.0, 0.0, 1.0])).abs().max() > _ROUNDING:
        return f"has a pose whose last row is {_numbers(matrix[3])}, not 0 0 0 1"
    rotation = matrix[:3, :3]
    error = float((rotation @ rotation.T - torch.eye(3).double()).abs().max())
    if not error <= tolerance:  # a NaN that arose from huge numbers is no rotation either
        return f"has a pose whose rotation is not orthonormal (off by {error:.2g})"
    if torch.linalg.det(rotation) < 0:
        return "has a mirrored camera (its rotation is left-handed)"
    distance = float(matrix[:3, 3].norm())
    if distance > MAX_DISTANCE:
        return f"stands {distance:.3g} units from the origin, too far for single precision"
    return None


def check_intrinsics(
    matrix: Float[Tensor, "rows columns"],
    *,
    where: str,
    width: int,
    height: int,
    margin: float = 0.0,
) -> None:
    """Refuse intrinsics that belong to no pinhole camera of such an image.

    Args:
        matrix: K in pixels of width x height.
        where: File and camera, the subject of the message.
        width: Of the image, pixels.
        height: Likewise.
        margin: How far outside the image the principal point may lie, in image sides: 0 for
            photos as they were taken; parts of pictures need more.

    Raises:
        ValueError: The image has no such size; or K is not 3 x 3, not finite, not upper
            triangular, skewed, or has a focal length or a principal point of another image.
    """
    if min(width, height) < 1 or max(width, height) > MAX_SIDE:
        raise ValueError(
            f"{where} cannot have {width} x {height} pixels; an image has 1 to {MAX_SIDE} a side"
        )
    fault = _intrinsics_fault(matrix.double(), width, height, margin)
    if fault is not None:
        raise ValueError(
            f"{where} {fault}; give fx 0 cx, 0 fy cy, 0 0 1 in pixels of its {width} x {height} "
            "image"
        )


def _intrinsics_fault(
    matrix: Float[Tensor, "rows columns"], width: int, height: int, margin: float
) -> str | None:
    if matrix.shape != (3, 3):
        return f"has intrinsics of {_shape(matrix)} numbers instead of 3 x 3"
    if not matrix.isfinite().all():
        return "has intrinsics that are not finite"
    (fx, skew, cx), (lower, fy, cy), last = matrix.tolist()
    if min(fx, fy) <= 0:
        return f"has the focal length {min(fx, fy):g}, which must be above 0"
    if max(abs(last[0]), abs(last[1]), abs(last[2] - 1)) > _ROUNDING:
        return f"has intrinsics whose last row is {_numbers(matrix[2])}, not 0 0 1"
    if abs(lower) > _ROUNDING * fy:
        return f"has intrinsics with {lower:g} below the diagonal, where 0 must stand"
    if abs(skew) > SKEW_TOLERANCE * fx:
        return f"has intrinsics with a skew of {skew:g}, which is not supported"
    low, high = FOCAL_RANGE
    if not (low * width <= fx <= high * width and low * height <= fy <= high * height):
        return f"has the focal lengths {fx:g} and {fy:g}, which are those of another size"
    if not (
        -margin * width <= cx <= (1 + margin) * width
        and -margin * height <= cy <= (1 + margin) * height
    ):
        return f"has the principal point ({cx:g}, {cy:g}), which is that of another size"
    return None


def _shape(matrix: Float[Tensor, "rows columns"]) -> str:
    return " x ".join(str(side) for side in matrix.shape)


def _numbers(row: Float[Tensor, " column"]) -> str:
    return " ".join(f"{value:g}" for value in row.tolist())
