"""Bringing a camera from the photo it was made for to the upright, fitted image of the model."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid
from instok3d.photos.cameras import PhotoCamera
from instok3d.photos.pixel_map import PixelMap, upright_from_stored

MAX_DISTORTION = 0.05
"""Of the image diagonal: a lens that moves any pixel by more is refused."""
ONE_PLACE = 1e-9
"""Cameras nearer to each other, in scene units and in distances from the origin, stand together."""
_MIRRORED = (2, 4, 5, 7)


@dataclass(frozen=True)
class FittedCamera:
    """The camera of one image as the model sees it."""

    intrinsics: Float[Tensor, "3 3"]
    """Pixels of the model's image, float64."""
    cam_from_world: Float[Tensor, "4 4"]
    """float64, the world of the camera file."""
    turned_by: int
    """The EXIF orientation that the camera and its depth picture had to follow, else 1."""


def fit_camera(
    camera: PhotoCamera, pixel_map: PixelMap, path: Path, notes: list[str]
) -> FittedCamera:
    """The camera of the model's image.

    A camera made at another resolution of the same shape is scaled. Most programs that make
    cameras ignore EXIF, so a camera may belong to the photo before it was turned upright: it is
    then turned about its axis with the photo.

    Args:
        camera: Of the photo at any resolution.
        pixel_map: How the photo was fitted.
        path: The photo, for messages.
        notes: Gets a sentence where the file leaves open which image the camera belongs to.

    Raises:
        ValueError: The photo has another shape than the camera's image, or is mirrored by EXIF.
    """
    upright_height, upright_width = pixel_map.original_height, pixel_map.original_width
    orientation = pixel_map.exif_orientation
    height, width = upright_height, upright_width
    if orientation >= 5:
        height, width = width, height
    size = (camera.height, camera.width)
    fits_upright = same_shape(size, (upright_height, upright_width))
    follows_stored = orientation != 1 and same_shape(size, (height, width))
    if not follows_stored and not fits_upright:
        raise ValueError(
            f"the camera of {path} is for an image of {camera.width} x {camera.height}, but the "
            f"photo has {upright_width} x {upright_height}; give the photos that the cameras were "
            "made from"
        )
    if not follows_stored:
        intrinsics = _scaled(camera, upright_height, upright_width)
        return FittedCamera(pixel_map.intrinsics_to_model(intrinsics), camera.cam_from_world, 1)
    if orientation in _MIRRORED:
        raise ValueError(
            f"{path} is mirrored by its EXIF orientation {orientation}, which no camera can "
            "follow; save it upright and make the cameras again"
        )
    if fits_upright:
        notes.append(
            f"{path.name} is turned by its EXIF orientation {orientation}; its camera was taken "
            "to belong to the photo before it was turned, as most programs do"
        )
    # Turning about the axis by R moves pixels by A: A K = K' R, so K' = A K R^-1.
    pixels = upright_from_stored(orientation, height, width)
    turn = torch.eye(4, dtype=torch.float64)
    turn[:2, :2] = pixels[:2, :2]
    intrinsics = pixels @ _scaled(camera, height, width) @ turn[:3, :3].T
    return FittedCamera(
        pixel_map.intrinsics_to_model(intrinsics), turn @ camera.cam_from_world, orientation
    )


def same_shape(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether one (height, width) is the other at some resolution, up to a rounded pixel."""
    wanted = size[1] * other[0] / size[0]
    return abs(wanted - other[1]) <= max(1.0, 0.005 * other[1])


def check_distortion(cameras: Sequence[PhotoCamera], notes: list[str]) -> None:
    """Refuse lenses that are far from a pinhole, and note what is ignored in the others.

    Raises:
        ValueError: A lens moves a pixel by more than MAX_DISTORTION.
    """
    shifts = [camera.distortion_shift for camera in cameras]
    shift = max(shifts)
    worst = cameras[shifts.index(shift)]
    if not shift <= MAX_DISTORTION:
        raise ValueError(
            f"the lens of {worst.name} moves pixels by {shift:.0%} of the image diagonal, "
            f"more than {MAX_DISTORTION:.0%}; undistort the photos first"
        )
    if shift > 0:
        notes.append(
            f"lens distortion is ignored: it moves pixels by up to {shift:.1%} of the image "
            "diagonal"
        )


def check_distance(cameras: Sequence[PhotoCamera]) -> None:
    """Refuse worlds whose origin is so far away that single precision blurs the cameras.

    Raises:
        ValueError: One step of a 32-bit number is over a thousandth of the cameras' spread.
    """
    cam_from_world = torch.stack([camera.cam_from_world for camera in cameras])
    centers = invert_rigid(cam_from_world)[:, :3, 3]
    away = float(centers.norm(dim=1).max())
    spread = float((centers - centers.mean(dim=0)).norm(dim=1).max())
    if spread <= ONE_PLACE * max(away, 1.0):
        return  # cameras that only turn; what is left of their distances is rounding
    step = away * torch.finfo(torch.float32).eps
    if step > 1e-3 * spread:
        raise ValueError(
            f"the cameras stand {away:.3g} units from the origin of their world but only "
            f"{spread:.3g} apart; move the origin of the camera file to the scene"
        )


def _scaled(camera: PhotoCamera, height: int, width: int) -> Float[Tensor, "3 3"]:
    scale = torch.tensor([width / camera.width, height / camera.height, 1.0], dtype=torch.float64)
    return scale[:, None] * camera.intrinsics
