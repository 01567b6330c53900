"""One image file in, one upright sRGB picture of the model's size out, whatever its pixel format.

Nothing large is decoded before the header was checked, and JPEGs are decoded at a fraction of
their size where the model's image is small.
"""

import hashlib
import io
import math
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image, UnidentifiedImageError
from torch import Tensor

from instok3d.photos.file_names import check_regular_file
from instok3d.photos.pixel_map import Fit, PixelMap, fit_pixels, upright_from_stored

FORMATS = ("JPEG", "MPO", "PNG", "WEBP", "TIFF", "BMP", "PPM", "GIF", "AVIF", "HEIF")
"""What is decoded; the other readers of Pillow (one of them starts a program) stay off."""
MAX_PIXELS = 64_000_000
"""Photos with more are refused before they are decoded: a phone's largest have 50 million."""
LETTERBOX_GREY = 0.5
DIAGONAL_35MM = math.hypot(36.0, 24.0)
_BROKEN = (
    *(OSError, SyntaxError, ValueError, EOFError, LookupError, TypeError, RuntimeError),
    *(ArithmeticError, struct.error, zlib.error),
)
"""What Pillow's decoders raise for damaged files."""
_HEIC_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"mif1")
_TRANSPOSE = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}


@dataclass(frozen=True)
class DecodedPhoto:
    """One photo at the model's size."""

    image: Float[Tensor, "3 height width"]
    """sRGB in [0, 1]. Transparent parts lie on white; letterbox bars are grey."""
    pixel_map: PixelMap
    sha256: str
    """Of the bytes of the file."""
    focal: float | None
    """Focal length in pixels of the upright original by EXIF, None where it does not say."""
    notes: tuple[str, ...]
    """What was left out or guessed, each one sentence."""


@contextmanager
def own_pixel_limit() -> Iterator[None]:
    """Switch Pillow's own limit on image size off while ours is at work.

    Pillow's limit is one number for the whole process, so enter this once around all threads
    that decode, never inside them.
    """
    before = Image.MAX_IMAGE_PIXELS
    Image.MAX_IMAGE_PIXELS = None
    try:
        yield
    finally:
        Image.MAX_IMAGE_PIXELS = before


def decode_photo(
    path: Path,
    *,
    height: int,
    width: int,
    fit: Fit | Callable[[PixelMap], PixelMap] = "crop",
    max_pixels: int = MAX_PIXELS,
) -> DecodedPhoto:
    """Read one photo, turn it upright, fit it into height x width with antialiasing.

    See `decode_bytes`.

    Args:
        path: The photo.
        height: Of the result.
        width: Of the result.
        fit: As in `decode_bytes`.
        max_pixels: Photos with more are refused.

    Raises:
        FileNotFoundError: There is no such file.
        PermissionError: It may not be read.
        ValueError: It is no image, cut off, larger than max_pixels, or needs a missing plugin.
    """
    data = _read_bytes(path, max_pixels)
    return decode_bytes(data, path, height=height, width=width, fit=fit, max_pixels=max_pixels)


def decode_bytes(
    data: bytes,
    path: Path,
    *,
    height: int,
    width: int,
    fit: Fit | Callable[[PixelMap], PixelMap] = "crop",
    max_pixels: int = MAX_PIXELS,
) -> DecodedPhoto:
    """The bytes of a photo as one picture, upright, fitted into height x width with antialiasing.

    Grey becomes RGB, 16 bits keep their full range, CMYK and wide-gamut profiles are converted
    to sRGB, transparent pixels are laid on white, of an animation the first picture is taken.

    Args:
        data: Of a file.
        path: What messages call it.
        height: Of the result.
        width: Of the result.
        fit: Or a function that gives the map from the whole upright photo to the result, given
            the map from the photo to itself.
        max_pixels: Photos with more are refused.

    Raises:
        ValueError: It is no image, cut off, larger than max_pixels, or needs a missing plugin.
    """
    image = _open(path, data)
    _check_pixels(path, image.height, image.width, max_pixels)
    notes: list[str] = []
    if image.format == "TIFF":
        with _naming(path):
            image.load()  # which turns it upright and drops the tag
    stored_width, stored_height = image.size
    orientation, focal = _read_exif(path, image, notes)
    with _naming(path):
        if getattr(image, "n_frames", 1) > 1 and image.format != "MPO":
            notes.append(f"{path.name} holds several pictures; only the first one is used")
    turned = orientation >= 5
    upright = (stored_width, stored_height) if turned else (stored_height, stored_width)
    if callable(fit):
        pixel_map = fit(fit_pixels(*upright, *upright, exif_orientation=orientation))
    else:
        pixel_map = fit_pixels(*upright, height, width, fit=fit, exif_orientation=orientation)
    with _naming(path):
        profile = image.info.get("icc_profile")
        pixels = _to_rgb(_resample(image, pixel_map), profile, path, notes)
    return DecodedPhoto(
        image=_place(torch.from_numpy(pixels), pixel_map),
        pixel_map=pixel_map,
        sha256=hashlib.sha256(data).hexdigest(),
        focal=focal,
        notes=tuple(notes),
    )


@contextmanager
def naming_damage(what: object, remedy: str = "download it again") -> Iterator[None]:
    """Whatever a decoder of Pillow raises becomes a ValueError that names the picture."""
    try:
        yield
    except UnidentifiedImageError as error:  # which tells an address in memory
        raise ValueError(
            f"{what} is damaged or not of the wanted picture format; {remedy}"
        ) from error
    except (*_BROKEN, Image.DecompressionBombError) as error:
        raise ValueError(f"{what} is damaged or cut off ({error}); {remedy}") from error


def picture_formats() -> list[str]:
    """The formats that are decoded, as far as this installation can."""
    Image.init()
    return [name for name in FORMATS if name in Image.OPEN]


def is_picture(path: Path) -> bool:
    """Whether a file begins like a picture, damaged ones too; only its header is read."""
    try:
        with path.open("rb") as stream:
            if _is_heic(stream.read(32)):
                return True
        with Image.open(path, formats=picture_formats()):
            return True
    except UnidentifiedImageError:
        return False
    except (*_BROKEN, Image.DecompressionBombError):
        return True


def _is_heic(data: bytes) -> bool:
    brands = data[8:32] if data[4:8] == b"ftyp" else b""
    return b"avif" not in brands and any(brand in brands for brand in _HEIC_BRANDS)


def _naming(path: Path) -> AbstractContextManager[None]:
    return naming_damage(path, "copy it again or leave it out")


def _read_bytes(path: Path, max_pixels: int) -> bytes:
    check_regular_file(path)
    try:
        size = path.stat().st_size
        limit = 8 * max_pixels + 2**20  # nothing within max_pixels takes 8 bytes a pixel
        if size > limit:
            raise ValueError(
                f"{path} has {size / 1e6:.0f} MB, more than {max_pixels / 1e6:g} megapixels can "
                "take; make it smaller"
            )
        data = path.read_bytes()
    except PermissionError as error:
        raise PermissionError(f"{path} may not be read; change its permissions") from error
    if not data:
        raise ValueError(f"{path} is empty (0 bytes); copy it again or leave it out")
    return data


def _open(path: Path, data: bytes) -> Image.Image:
    if _is_heic(data):
        _register_heif(path)
    try:
        return Image.open(io.BytesIO(data), formats=picture_formats())
    except UnidentifiedImageError as error:
        raise ValueError(
            f"{path} is not a picture in a known format (it begins with {data[:8]!r}); leave it "
            "out or save it as JPEG or PNG; a video must be the only input"
        ) from error
    except Image.DecompressionBombError as error:  # only outside own_pixel_limit
        raise ValueError(f"{path} is too large to decode ({error}); make it smaller") from error
    except _BROKEN as error:
        raise ValueError(
            f"{path} has a broken header ({error}); copy it again or leave it out"
        ) from error


def _register_heif(path: Path) -> None:
    try:
        import pillow_heif
    except ImportError as error:
        raise ValueError(
            f"{path} is a HEIC picture, which needs a plugin: pip install 'instok3d[heic]', "
            "or save it as JPEG"
        ) from error
    pillow_heif.register_heif_opener()


def _check_pixels(path: Path, height: int, width: int, max_pixels: int) -> None:
    if height * width > max_pixels:
        raise ValueError(
            f"{path} has {width} x {height} = {height * width / 1e6:.1f} megapixels, more than "
            f"the limit of {max_pixels / 1e6:g}; make it smaller"
        )


def _read_exif(path: Path, image: Image.Image, notes: list[str]) -> tuple[int, float | None]:
    try:
        exif = image.getexif()
        orientation, details = exif.get(0x0112, 1), exif.get_ifd(0x8769)
    except _BROKEN as error:
        notes.append(f"the EXIF data of {path.name} is broken ({error}); taken as upright")
        return 1, None
    if orientation not in range(1, 9):
        notes.append(f"{path.name} has the unknown EXIF orientation {orientation}; not turned")
        orientation = 1
    return int(orientation), _exif_focal(details, *image.size)


def _exif_focal(details: dict[int, object], width: int, height: int) -> float | None:
    """By FocalLengthIn35mmFilm, which compares diagonals; None after a crop or without it."""
    focal_35mm = details.get(0xA405)
    if not isinstance(focal_35mm, (int, float)) or not 5 <= focal_35mm <= 2000:
        return None
    taken = sorted(v for v in (details.get(0xA002), details.get(0xA003)) if isinstance(v, int))
    if len(taken) == 2 and taken[0] > 0:
        short, long = sorted((width, height))
        if abs(long / short - taken[1] / taken[0]) > 0.02 * long / short:
            return None
    return focal_35mm / DIAGONAL_35MM * math.hypot(width, height)


def _resample(image: Image.Image, pixel_map: PixelMap) -> Image.Image:
    """The seen part of the photo, upright, at the model's scale, still in its own colours."""
    orientation = pixel_map.exif_orientation
    left, top, right, bottom = pixel_map.source_box
    width = round((right - left) * pixel_map.scale_x)
    height = round((bottom - top) * pixel_map.scale_y)
    if orientation >= 5:
        width, height = height, width
    (left, top), (right, bottom) = _stored_corners(image, pixel_map)
    reduction = _decode_reduced(image, (right - left) / width, (bottom - top) / height)
    box = (
        max(left / reduction, 0.0),
        max(top / reduction, 0.0),
        min(right / reduction, float(image.width)),
        min(bottom / reduction, float(image.height)),
    )
    image = _to_resizable(image)
    image = image.resize((width, height), Image.Resampling.LANCZOS, box=box, reducing_gap=3.0)
    return image.transpose(_TRANSPOSE[orientation]) if orientation in _TRANSPOSE else image


def _stored_corners(image: Image.Image, pixel_map: PixelMap) -> list[list[float]]:
    """Top-left and bottom-right of the seen part, in the pixels of the file before its turn."""
    left, top, right, bottom = pixel_map.source_box
    corners = torch.tensor([[left, top, 1.0], [right, bottom, 1.0]], dtype=torch.float64)
    turn = upright_from_stored(pixel_map.exif_orientation, image.height, image.width)
    return (corners @ torch.linalg.inv(turn).T)[:, :2].sort(dim=0).values.tolist()


def _decode_reduced(image: Image.Image, shrink_x: float, shrink_y: float) -> float:
    """Decode a JPEG no larger than needed and return by how much it was reduced (1, 2, 4, 8).

    At least twice the wanted size is kept, so that the antialiasing filter does the last step.
    """
    width, height = image.size
    ratio = min(shrink_x, shrink_y) / 2
    result = None
    if ratio >= 2 and image.format in ("JPEG", "MPO"):
        result = image.draft(None, (math.ceil(width / ratio), math.ceil(height / ratio)))
    image.load()
    return 1.0 if result is None else width / result[1][2]


def _to_resizable(image: Image.Image) -> Image.Image:
    """In a mode that can be averaged: L, LA, RGB, RGBA, CMYK, or F in [0, 255]."""
    if image.mode in ("P", "PA", "RGB", "L") and "transparency" in image.info:
        return image.convert("RGBA")
    if image.mode in ("L", "LA", "RGB", "RGBA", "CMYK"):
        return image
    if image.mode == "1":
        return image.convert("L")
    if image.mode in ("PA", "La", "RGBa"):
        return image.convert("RGBA")
    if image.mode.startswith("I") or image.mode == "F":
        values = np.asarray(image, dtype=np.float32)
        full = 1.0 if image.mode == "F" else 65535.0
        if not (np.isfinite(values).all() and values.min() >= 0 and values.max() <= full):
            raise ValueError(f"its grey values leave the range from 0 to {full:g}")
        return Image.fromarray(values * np.float32(255.0 / full))
    return image.convert("RGB")


def _to_rgb(
    image: Image.Image, profile: bytes | None, path: Path, notes: list[str]
) -> Float[np.ndarray, "3 height width"]:
    if image.mode == "F":
        grey = np.clip(np.asarray(image) / np.float32(255), 0, 1)
        return np.stack([grey, grey, grey])
    if image.mode in ("LA", "RGBA"):
        image = image.convert("RGBA")
        white = Image.new("RGBA", image.size, "white")
        image = Image.alpha_composite(white, image).convert("RGB")
    if profile and image.mode in ("RGB", "CMYK"):
        image = _to_srgb(image, profile, path, notes)
    return np.asarray(image.convert("RGB"), dtype=np.float32).transpose(2, 0, 1) / np.float32(255)


def _to_srgb(image: Image.Image, profile: bytes, path: Path, notes: list[str]) -> Image.Image:
    from PIL import ImageCms

    if profile[16:20].strip() != image.mode.encode():  # made for other pixels than these
        return image
    try:
        source = ImageCms.getOpenProfile(io.BytesIO(profile))
        target = ImageCms.createProfile("sRGB")
        converted = ImageCms.profileToProfile(image, source, target, outputMode="RGB")
    except (ImageCms.PyCMSError, OSError) as error:
        notes.append(f"the colour profile of {path.name} is broken ({error}); taken as sRGB")
        return image
    return image if converted is None else converted


def _place(picture: Float[Tensor, "3 inner_height inner_width"], pixel_map: PixelMap) -> Tensor:
    if picture.shape[1:] == (pixel_map.height, pixel_map.width):
        return picture.contiguous()
    result = torch.full((3, pixel_map.height, pixel_map.width), LETTERBOX_GREY)
    top, left = round(max(pixel_map.offset_y, 0.0)), round(max(pixel_map.offset_x, 0.0))
    result[:, top : top + picture.shape[1], left : left + picture.shape[2]] = picture
    return result
