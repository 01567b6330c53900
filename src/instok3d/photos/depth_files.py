"""Depth pictures of sensors: read into scene units, brought to the model's pixels by nearest."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image, UnidentifiedImageError
from torch import Tensor

from instok3d.geometry.cameras import pixel_centers
from instok3d.photos.pixel_map import PixelMap, upright_from_stored

MISSING_16_BIT = 65535
"""What several sensors store for "no depth"; read as 0 like everything that is not finite."""


def read_depth(
    path: Path, *, scale: float, max_pixels: int = 64_000_000
) -> Float[Tensor, "height width"]:
    """z-depth in scene units, 0 where it is unknown.

    Args:
        path: A 16-bit or float picture (PNG, PGM, TIFF), or a .npy array.
        scale: Stored numbers in one scene unit.
        max_pixels: Larger pictures are refused before they are decoded.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is not a depth picture, is damaged, or is too large.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no depth file {path}")
    try:
        values = _read_array(path) if path.suffix == ".npy" else _read_picture(path, max_pixels)
    except UnidentifiedImageError as error:
        raise ValueError(f"{path} is not a depth picture in a known format") from error
    except Image.DecompressionBombError as error:
        raise ValueError(f"{path} is too large to decode ({error})") from error
    except (OSError, SyntaxError, EOFError) as error:
        raise ValueError(f"{path} is damaged or cut off ({error})") from error
    if values.ndim != 2 or values.dtype.kind not in "uif":
        raise ValueError(
            f"{path} holds {values.dtype} of shape {values.shape}, wanted one number a pixel"
        )
    known = np.isfinite(values) & (values > 0)
    if values.dtype.kind in "ui":
        known &= values != MISSING_16_BIT
    return torch.from_numpy(np.where(known, values, 0).astype(np.float32) / np.float32(scale))


def depth_at_model_pixels(
    depth: Float[Tensor, "depth_height depth_width"],
    pixel_map: PixelMap,
    *,
    stored_orientation: int = 1,
) -> Float[Tensor, "height width"]:
    """The depth at the centre of every pixel of the model's image; 0 on letterbox bars.

    Nearest, so that no depth between two surfaces arises. The depth picture may have another
    resolution than its photo, but shows the same view.

    Args:
        depth: Of the whole original photo.
        pixel_map: How the photo was fitted.
        stored_orientation: The EXIF orientation by which the depth has to be turned too.
    """
    centers = pixel_centers(pixel_map.height, pixel_map.width, like=torch.empty(0).double())
    original = pixel_map.to_original(centers.flatten(0, 1))
    size = original.new_tensor([pixel_map.original_width, pixel_map.original_height])
    inside = ((original >= 0) & (original < size)).all(dim=-1)
    unit = original / size  # 0 to 1 across the upright photo
    upright_from_unit = upright_from_stored(stored_orientation, 1, 1)
    homogeneous = torch.cat([unit, torch.ones_like(unit[:, :1])], dim=1)
    unit = (homogeneous @ torch.linalg.inv(upright_from_unit).T)[:, :2]
    height, width = depth.shape
    column = (unit[:, 0] * width).floor().long().clamp(0, width - 1)
    row = (unit[:, 1] * height).floor().long().clamp(0, height - 1)
    values = torch.where(inside, depth[row, column], torch.zeros_like(depth[row, column]))
    return values.view(pixel_map.height, pixel_map.width)


def _read_array(path: Path) -> np.ndarray:
    try:
        return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))
    except ValueError as error:
        raise ValueError(f"{path} is not a .npy array of numbers ({error})") from error


def _read_picture(path: Path, max_pixels: int) -> np.ndarray:
    with Image.open(path, formats=["PNG", "PPM", "TIFF"]) as image:
        if image.width * image.height > max_pixels:
            raise ValueError(
                f"{path} has {image.width * image.height / 1e6:.1f} megapixels, more than the "
                f"limit of {max_pixels / 1e6:g}"
            )
        if not (image.mode.startswith("I") or image.mode == "F"):
            raise ValueError(
                f"{path} has {image.mode} pixels, wanted one 16-bit or float number a pixel"
            )
        return np.asarray(image)
