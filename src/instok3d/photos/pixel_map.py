"""Where a pixel that the model sees lies in the photo as it was taken, and back."""

from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.cameras import resize_intrinsics

Fit = Literal["crop", "letterbox"]
"""crop: fill the model's image and lose the border; letterbox: keep everything and add bars."""


@dataclass(frozen=True)
class PixelMap:
    """How one photo was fitted into the model's image: x_model = scale_x * x_original + offset_x.

    Original pixels are those of the photo turned upright by its EXIF orientation. In both images
    the centre of the top-left pixel is (0.5, 0.5).
    """

    original_height: int
    """Of the upright photo."""
    original_width: int
    exif_orientation: int
    """1 to 8: how the stored file was turned to stand upright; 1 is not at all, and also what
    formats get whose decoder turns them by itself (TIFF, HEIC)."""
    height: int
    """Of the model's image."""
    width: int
    scale_x: float
    scale_y: float
    offset_x: float
    """Model pixels; negative where the border was cropped, positive where a bar was added."""
    offset_y: float

    def to_model(self, points: Float[Tensor, "*point 2"]) -> Float[Tensor, "*point 2"]:
        """Model pixels (x, y) of original pixels (x, y)."""
        scale, offset = self._scale_and_offset(points)
        return points * scale + offset

    def to_original(self, points: Float[Tensor, "*point 2"]) -> Float[Tensor, "*point 2"]:
        """Original pixels (x, y) of model pixels (x, y); outside the photo on a letterbox bar."""
        scale, offset = self._scale_and_offset(points)
        return (points - offset) / scale

    def intrinsics_to_model(
        self, intrinsics: Float[Tensor, "*batch 3 3"]
    ) -> Float[Tensor, "*batch 3 3"]:
        """Intrinsics of the model's image from those of the original photo."""
        return resize_intrinsics(
            intrinsics,
            scale_x=self.scale_x,
            scale_y=self.scale_y,
            offset_x=self.offset_x,
            offset_y=self.offset_y,
        )

    def intrinsics_to_original(
        self, intrinsics: Float[Tensor, "*batch 3 3"]
    ) -> Float[Tensor, "*batch 3 3"]:
        """Intrinsics of the original photo from those of the model's image."""
        return resize_intrinsics(
            intrinsics,
            scale_x=1 / self.scale_x,
            scale_y=1 / self.scale_y,
            offset_x=-self.offset_x / self.scale_x,
            offset_y=-self.offset_y / self.scale_y,
        )

    def resized(self, height: int, width: int) -> "PixelMap":
        """The map to an image of another size that shows the same part of the photo."""
        by_x, by_y = width / self.width, height / self.height
        return replace(
            self, height=height, width=width,
            scale_x=self.scale_x * by_x, scale_y=self.scale_y * by_y,
            offset_x=self.offset_x * by_x, offset_y=self.offset_y * by_y,
        )  # fmt: skip

    @property
    def source_box(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom of the seen part of the photo, in original pixels."""
        left, top = -self.offset_x / self.scale_x, -self.offset_y / self.scale_y
        right, bottom = left + self.width / self.scale_x, top + self.height / self.scale_y
        return (
            max(left, 0.0),
            max(top, 0.0),
            min(right, float(self.original_width)),
            min(bottom, float(self.original_height)),
        )

    @property
    def seen_share(self) -> float:
        """The share of the photo's area that lies inside the model's image, in (0, 1]."""
        left, top, right, bottom = self.source_box
        return (right - left) * (bottom - top) / (self.original_height * self.original_width)

    def _scale_and_offset(self, like: Tensor) -> tuple[Tensor, Tensor]:
        return like.new_tensor([self.scale_x, self.scale_y]), like.new_tensor(
            [self.offset_x, self.offset_y]
        )


def fit_pixels(
    original_height: int,
    original_width: int,
    height: int,
    width: int,
    *,
    fit: Fit = "crop",
    exif_orientation: int = 1,
) -> PixelMap:
    """The map that fits an upright photo into the model's image, centred.

    crop scales both axes by exactly the same factor; letterbox rounds the photo's sides to whole
    model pixels (so that it has sharp edges), each axis by its own exact factor.

    Raises:
        ValueError: A side is below 1 or fit is not one of the two words.
    """
    if min(original_height, original_width, height, width) < 1:
        raise ValueError(
            f"image sides must be at least 1 pixel, got a photo of {original_height} x "
            f"{original_width} and a model image of {height} x {width}"
        )
    ratio_y, ratio_x = height / original_height, width / original_width
    if fit == "crop":
        scale_x = scale_y = max(ratio_x, ratio_y)
        offset_x = 0.5 * (width - original_width * scale_x)
        offset_y = 0.5 * (height - original_height * scale_y)
    elif fit == "letterbox":
        inner_width = max(1, round(original_width * min(ratio_x, ratio_y)))
        inner_height = max(1, round(original_height * min(ratio_x, ratio_y)))
        scale_x, scale_y = inner_width / original_width, inner_height / original_height
        offset_x, offset_y = float((width - inner_width) // 2), float((height - inner_height) // 2)
    else:
        raise ValueError(f"fit must be 'crop' or 'letterbox', got {fit!r}")
    return PixelMap(
        original_height=original_height,
        original_width=original_width,
        exif_orientation=exif_orientation,
        height=height,
        width=width,
        scale_x=scale_x,
        scale_y=scale_y,
        offset_x=offset_x,
        offset_y=offset_y,
    )


def upright_from_stored(orientation: int, height: int, width: int) -> Float[Tensor, "3 3"]:
    """Pixels of the upright photo from pixels of the stored file, as an affine map (float64).

    Args:
        orientation: The EXIF orientation tag, 1 to 8.
        height: Of the stored file, before it is turned.
        width: Of the stored file.
    """
    rows = {
        1: ((1, 0, 0), (0, 1, 0)),
        2: ((-1, 0, width), (0, 1, 0)),
        3: ((-1, 0, width), (0, -1, height)),
        4: ((1, 0, 0), (0, -1, height)),
        5: ((0, 1, 0), (1, 0, 0)),
        6: ((0, -1, height), (1, 0, 0)),
        7: ((0, -1, height), (-1, 0, width)),
        8: ((0, 1, 0), (-1, 0, width)),
    }[orientation]
    return torch.tensor([*rows, (0, 0, 1)], dtype=torch.float64)
