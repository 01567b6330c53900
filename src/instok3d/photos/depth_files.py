"""Depth pictures of sensors: read into scene units, brought to the model's pixels by nearest."""

import io
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Shaped, UInt16
from PIL import Image, UnidentifiedImageError
from torch import Tensor

from instok3d.geometry.cameras import pixel_centers
from instok3d.geometry.checks import MAX_DISTANCE
from instok3d.photos.camera_fit import same_shape
from instok3d.photos.cameras import PhotoCamera
from instok3d.photos.pixel_map import PixelMap, upright_from_stored
from instok3d.reading import naming_damage, parse_npy

MAX_PIXELS = 64_000_000
"""Larger pictures are refused before they are decoded."""
MISSING_16_BIT = 65535
"""What several sensors store for "no depth"; read as 0 like everything that is not finite."""


def read_depth(
    path: Path, *, scale: float, max_pixels: int = MAX_PIXELS
) -> Float[Tensor, "height width"]:
    """z-depth in scene units, 0 where it is unknown: not finite, not above 0, or endlessly far.

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
    with naming_damage(path, "export it again"):
        is_array = path.suffix.lower() == ".npy"
        values = _read_array(path, max_pixels) if is_array else _read_picture(path, max_pixels)
    if values.ndim != 2 or values.dtype.kind not in "uif":
        raise ValueError(
            f"{path} holds {values.dtype} of shape {values.shape}, wanted one number a pixel"
        )
    height, width = values.shape
    _check_pixels(path, height, width, max_pixels)
    if values.dtype.kind in "ui":
        values = np.where(values == MISSING_16_BIT, 0, values)
        if _is_byte_swapped(values):
            raise ValueError(
                f"{path} looks byte-swapped: its numbers jump from pixel to pixel, with their two "
                "bytes exchanged they do not; write it in the other byte order"
            )
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        depth = values.astype(np.float32) / np.float32(scale)
    return torch.from_numpy(np.where((depth > 0) & (depth <= MAX_DISTANCE), depth, np.float32(0)))


def _is_byte_swapped(values: Shaped[np.ndarray, "height width"]) -> bool:
    """Whether numbers of 16 bits are smooth only after their bytes are exchanged."""
    if values.size == 0 or values.max() > np.iinfo(np.uint16).max or values.min() < 0:
        return False
    as_read = values.astype(np.uint16)
    roughness = _roughness(as_read)
    return roughness > 0.01 and roughness > 4 * _roughness(as_read.byteswap())


def _roughness(values: UInt16[np.ndarray, "height width"]) -> float:
    """Mean step between known neighbours in a row, in units of the mean value."""
    known = (values[:, 1:] > 0) & (values[:, :-1] > 0)
    steps = np.abs(np.diff(values.astype(np.float64), axis=1))[known]
    return float(steps.mean() / values[values > 0].mean()) if steps.size else 0.0


def read_camera_depth(
    camera: PhotoCamera, *, max_pixels: int = MAX_PIXELS
) -> Float[Tensor, "height width"]:
    """The depth picture that belongs to a camera; see `read_depth`.

    Raises:
        FileNotFoundError: The camera has none, or it is not there.
        ValueError: It is damaged, or has another shape than the camera's image.
    """
    if camera.depth_path is None:
        raise FileNotFoundError(f"the camera of {camera.name} has no depth picture")
    depth = read_depth(camera.depth_path, scale=camera.depth_scale, max_pixels=max_pixels)
    if not same_shape((depth.shape[0], depth.shape[1]), (camera.height, camera.width)):
        raise ValueError(
            f"{camera.depth_path} has {depth.shape[1]} x {depth.shape[0]} pixels, which is not "
            f"the shape of its camera's image of {camera.width} x {camera.height}"
        )
    return depth


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


def _check_pixels(path: Path, height: int, width: int, max_pixels: int) -> None:
    if height * width > max_pixels:
        raise ValueError(
            f"{path} has {width * height / 1e6:.1f} megapixels, more than the limit of "
            f"{max_pixels / 1e6:g}"
        )


def _read_bytes(path: Path, max_pixels: int) -> bytes:
    size, most = path.stat().st_size, 2**16 + 16 * max_pixels  # a header, the widest numbers
    if size > most:
        raise ValueError(f"{path} has {size} bytes, more than {max_pixels / 1e6:g} megapixels take")
    return path.read_bytes()


def _read_array(path: Path, max_pixels: int) -> np.ndarray:
    try:
        return parse_npy(_read_bytes(path, max_pixels), "it", "save it again with numpy.save")
    except ValueError as error:
        if str(error).startswith(str(path)):
            raise
        raise ValueError(f"{path} is not a .npy array of numbers: {error}") from error


def _read_picture(path: Path, max_pixels: int) -> np.ndarray:
    # From memory: of a file Pillow would first allocate whatever size a damaged chunk promises.
    data = io.BytesIO(_read_bytes(path, max_pixels))
    try:
        image = Image.open(data, formats=["PNG", "PPM", "TIFF"])
    except UnidentifiedImageError as error:
        raise ValueError(f"{path} is not a depth picture in a known format") from error
    except Image.DecompressionBombError as error:
        raise ValueError(f"{path} is too large to decode ({error})") from error
    _check_pixels(path, image.height, image.width, max_pixels)
    if not (image.mode.startswith("I") or image.mode == "F"):
        raise ValueError(
            f"{path} has {image.mode} pixels, wanted one 16-bit or float number a pixel"
        )
    return np.asarray(image)
