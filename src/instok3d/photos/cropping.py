"""The crop of Uni3R and LSM: square about the principal point, so that it ends in the middle."""

import numpy as np
from jaxtyping import Float, Shaped, UInt8
from PIL import Image
from torch import Tensor

from instok3d.photos.pixel_map import PixelMap


def crop_about_principal_point(
    intrinsics: Float[Tensor, "3 3"],
    original_height: int,
    original_width: int,
    height: int,
    width: int,
) -> PixelMap:
    """How a picture is cropped and scaled so that its principal point lies in the middle.

    The largest part that is symmetric about the rounded principal point, scaled by one factor
    until it just covers height x width, and its centre (method of DUSt3R, which Uni3R and LSM
    use). A picture smaller than that is enlarged. `PixelMap.intrinsics_to_model` gives the new
    intrinsics.

    Args:
        intrinsics: In pixels of the original picture.
        original_height: Of the picture.
        original_width: Of the picture.
        height: Wanted.
        width: Wanted.

    Raises:
        ValueError: The principal point is not inside the picture, as happens with intrinsics
            of another resolution, or a side is below 1.
    """
    if min(original_height, original_width, height, width) < 1:
        raise ValueError(
            f"image sides must be at least 1 pixel, got {original_height} x {original_width} and "
            f"{height} x {width}"
        )
    center_x, center_y = float(intrinsics[0, 2]), float(intrinsics[1, 2])
    if not (0.5 < center_x < original_width - 0.5 and 0.5 < center_y < original_height - 0.5):
        raise ValueError(
            f"the principal point ({center_x:g}, {center_y:g}) lies outside the picture of "
            f"{original_width} x {original_height}; the intrinsics belong to another resolution"
        )
    middle_x, middle_y = round(center_x), round(center_y)
    margin_x = min(middle_x, original_width - middle_x)
    margin_y = min(middle_y, original_height - middle_y)
    scale = max(0.5 * width / margin_x, 0.5 * height / margin_y)
    return PixelMap(
        original_height=original_height,
        original_width=original_width,
        exif_orientation=1,
        height=height,
        width=width,
        scale_x=scale,
        scale_y=scale,
        offset_x=0.5 * width - scale * middle_x,
        offset_y=0.5 * height - scale * middle_y,
    )


def crop_image(image: Image.Image, pixel_map: PixelMap) -> UInt8[np.ndarray, "height width 3"]:
    """The part of an RGB picture that the map keeps, by Lanczos."""
    cropped = image.convert("RGB").resize(
        (pixel_map.width, pixel_map.height), Image.Resampling.LANCZOS, box=pixel_map.source_box
    )
    return np.asarray(cropped)


def crop_values(
    values: Shaped[np.ndarray, "original_height original_width"], pixel_map: PixelMap
) -> Shaped[np.ndarray, "height width"]:
    """Depths or ids at the centres of the kept pixels: nearest, so that nothing is mixed.

    The values may have another resolution than the picture of the map, but show the same view.
    """
    left, top, right, bottom = pixel_map.source_box
    rows = _nearest(top, bottom, pixel_map.height, values.shape[0] / pixel_map.original_height)
    columns = _nearest(left, right, pixel_map.width, values.shape[1] / pixel_map.original_width)
    rows = rows.clip(0, values.shape[0] - 1)
    columns = columns.clip(0, values.shape[1] - 1)
    return np.ascontiguousarray(values[rows[:, None], columns])


def _nearest(first: float, last: float, count: int, resolution: float) -> np.ndarray:
    centers = first + (np.arange(count) + 0.5) * (last - first) / count
    return np.floor(centers * resolution).astype(np.int64)
