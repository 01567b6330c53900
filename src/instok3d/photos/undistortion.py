"""Taking lens distortion out of pictures."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Shaped, UInt8
from torch import Tensor
from torch.nn import functional

from instok3d.geometry.cameras import pixel_rays
from instok3d.photos.distortion import Distortion

MAX_ZOOM = 1.5


@dataclass(frozen=True)
class Undistortion:
    """Where each pixel of a pinhole picture lies in the picture that the lens made."""

    intrinsics: Float[Tensor, "3 3"]
    """Of the pinhole picture."""
    positions: Float[Tensor, "height width 2"]
    """x and y in the lens's picture, 0 to 1 from its left or upper edge to the other."""

    def reduced(self, factor: int) -> "Undistortion":
        """The same for a picture with so many times fewer rows and columns."""
        height, width = self.positions.shape[0] // factor, self.positions.shape[1] // factor
        blocks = self.positions.view(height, factor, width, factor, 2)
        scale = self.intrinsics.new_tensor([1 / factor, 1 / factor, 1.0])
        return Undistortion(scale[:, None] * self.intrinsics, blocks.mean(dim=(1, 3)))

    def colors(self, image: UInt8[np.ndarray, "any_height any_width 3"]) -> np.ndarray:
        """The picture without distortion, between pixels by bicubic interpolation."""
        source = torch.from_numpy(image.copy()).permute(2, 0, 1)[None].double()
        result = functional.grid_sample(
            source,
            2 * self.positions[None] - 1,
            mode="bicubic",
            padding_mode="border",
            align_corners=False,
        )
        return result[0].permute(1, 2, 0).round().clamp(0, 255).byte().numpy()

    def values(
        self, values: Shaped[np.ndarray, "any_height any_width"]
    ) -> Shaped[np.ndarray, "height width"]:
        """Depths or ids without distortion, by nearest; any resolution of the same view."""
        height, width = values.shape
        x, y = self.positions.numpy().transpose(2, 0, 1)
        columns = np.floor(x * width).astype(np.int64).clip(0, width - 1)
        rows = np.floor(y * height).astype(np.int64).clip(0, height - 1)
        return values[rows, columns]


def undistortion(
    intrinsics: Float[Tensor, "3 3"],
    distortion: Distortion,
    height: int,
    width: int,
) -> Undistortion:
    """How to make the picture of a pinhole camera from that of a lens.

    Same size and principal point; the focal length grows as little as is needed for the lens's
    picture to cover everything.

    Args:
        intrinsics: Of the lens's picture at height x width, float64.
        distortion: Of the lens.
        height: Of both pictures.
        width: Of both pictures.

    Raises:
        ValueError: The focal length would have to grow by more than MAX_ZOOM.
    """
    size = intrinsics.new_tensor([width, height])
    margin = 0.5 / size  # the outer half pixel is not worth a larger focal length
    for zoom in np.arange(1.0, MAX_ZOOM, 0.005):
        zoomed = intrinsics * intrinsics.new_tensor([[zoom, 1, 1], [1, zoom, 1], [1, 1, 1]])
        points = pixel_rays(zoomed, height, width)[..., :2]
        bent = distortion.bend(points)
        positions = (bent @ intrinsics[:2, :2].T + intrinsics[:2, 2]) / size
        covered = ((positions >= -margin) & (positions <= 1 + margin)).all()
        if covered and not distortion.folds(points):
            return Undistortion(zoomed, positions)
    raise ValueError(
        f"the lens distortion {distortion} leaves gaps in the undistorted picture even at "
        f"{MAX_ZOOM:g} times its focal length; undistort the photos first "
        "(colmap image_undistorter)"
    )
