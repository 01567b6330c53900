"""Sizes of rendered pictures: what may be asked for, and what a camera sees at another size."""

import math
import warnings
from dataclasses import dataclass
from numbers import Integral

from instok3d.geometry.cameras import resize_intrinsics
from instok3d.types import Cameras

MAX_PICTURE_PIXELS = 2**25
"""The one limit on pictures, rendered or read with a scene: an 8K frame (7680 x 4320) fits, and a
rendering of so many pixels takes about 2 GB."""


@dataclass(frozen=True)
class SizedCameras:
    """Cameras with the size of their pictures."""

    cameras: Cameras
    """Unbatched; intrinsics for this size."""
    height: int
    width: int


def check_picture_size(height: int, width: int) -> None:
    """Refuse a size of which no picture can be made.

    Raises:
        ValueError: A side below 1 or not whole, or more than MAX_PICTURE_PIXELS.
    """
    for name, value in (("height", height), ("width", width)):
        if not isinstance(value, Integral) or value < 1:
            raise ValueError(f"{name} must be a whole number of at least 1 pixel, got {value!r}")
    if height * width > MAX_PICTURE_PIXELS:
        raise ValueError(
            f"height x width is {height} x {width}, which is {height * width:,} pixels; a picture "
            f"may have {MAX_PICTURE_PIXELS:,}: give a smaller height or width"
        )


def resize_cameras(own: SizedCameras, height: int | None, width: int | None) -> SizedCameras:
    """The cameras for pictures of another size, whose pixels stay as square as they were.

    One side alone keeps the shape. Both together show all that the cameras saw, as large as it
    fits, and more on two sides where the shape is another one; a warning says so.

    Args:
        own: What the cameras are for.
        height: Of the pictures, pixels; None is not given.
        width: Likewise.

    Raises:
        ValueError: See `check_picture_size`.
    """
    if height is None and width is None:
        return own
    check_picture_size(1 if height is None else height, 1 if width is None else width)
    if height is not None and width is not None:
        scale = min(height / own.height, width / own.width)
        _warn_of_shape(own, height, width, scale)
    elif height is not None:
        scale = height / own.height
        width = max(1, round(scale * own.width))
    else:
        assert width is not None
        scale = width / own.width
        height = max(1, round(scale * own.height))
    check_picture_size(height, width)
    intrinsics = resize_intrinsics(
        own.cameras.intrinsics,
        scale_x=scale,
        scale_y=scale,
        # What the other shape adds, or rounding, is shared between both sides.
        offset_x=0.5 * (width - scale * own.width),
        offset_y=0.5 * (height - scale * own.height),
    )
    return SizedCameras(Cameras(own.cameras.cam_from_world, intrinsics), height, width)


def _warn_of_shape(own: SizedCameras, height: int, width: int, scale: float) -> None:
    """Say how the field of view grows, where it does so by a pixel or more."""
    wider, higher = width - scale * own.width, height - scale * own.height
    if max(wider, higher) < 1 or not len(own.cameras.intrinsics):
        return
    axis, way = (0, "across") if wider > higher else (1, "from top to bottom")
    focal = float(own.cameras.intrinsics[0, axis, axis])
    before = _degrees((own.height, own.width)[1 - axis], focal)
    after = _degrees((height, width)[1 - axis], scale * focal)
    warnings.warn(
        f"pictures of {width} x {height} have another shape than the views of {own.width} x "
        f"{own.height}: their pixels stay square and they see {after:.0f} degrees {way} instead "
        f"of {before:.0f}; what no photo shows is empty",
        stacklevel=4,
    )


def _degrees(side: int, focal: float) -> float:
    """Field of view, principal point in the middle."""
    return math.degrees(2 * math.atan(0.5 * side / max(focal, 1e-9)))
