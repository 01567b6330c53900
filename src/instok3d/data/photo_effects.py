"""What cameras do to pictures, one effect a function; photos and renders are sRGB in [0, 1].

Every function takes the photos of one scene and one strength for each of them, and returns new ones
of the same shape. Lengths in pixels are stated at a height of 128 and grow with the picture.
"""

import io
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, UInt8
from PIL import Image
from torch import Tensor
from torch.nn import functional as F

Photos = Float[Tensor, "view 3 height width"]
PerView = Float[np.ndarray, " view"]

_LUMA = (0.299, 0.587, 0.114)


def luma(photos: Photos) -> Float[Tensor, "view 1 height width"]:
    """Brightness as JPEG and television define it, of the sRGB values as they are."""
    return (photos * photos.new_tensor(_LUMA).view(3, 1, 1)).sum(dim=1, keepdim=True)


def with_saturation(photos: Photos, factor: float) -> Photos:
    """Colours moved from their own grey (factor above 1) or to it (0: a grey picture)."""
    grey = luma(photos)
    return grey + factor * (photos - grey)


def with_contrast(photos: Photos, factor: float, middle: Float[Tensor, ""]) -> Photos:
    """Values moved from the middle (factor above 1) or to it."""
    return middle + factor * (photos - middle)


def with_gains(photos: Photos, gains: Float[np.ndarray, "view channel"]) -> Photos:
    """Values times a gain for each view and colour, not clipped; one channel: for all colours."""
    return photos * torch.from_numpy(gains).to(photos)[:, :, None, None]


def with_vignette(photos: Photos, amounts: PerView) -> Photos:
    """Darker with the square of the distance from the centre; corners by the amount."""
    row, column, _ = _from_centre(photos)
    radius_squared = row**2 + column**2  # 1 at the corners
    return photos * (1 - torch.from_numpy(amounts).to(photos).view(-1, 1, 1, 1) * radius_squared)


def with_distortion(photos: Photos, corner_shift_px: float) -> Photos:
    """Radial distortion; the corners show what is so far outside of them (negative: inside).

    The shift grows with the cube of the distance. Beyond the border the border is repeated.
    """
    row, column, half_diagonal = _from_centre(photos)
    height, width = photos.shape[-2:]
    shift = corner_shift_px * height / 128 / half_diagonal * (row**2 + column**2)
    # grid_sample wants -1..1 over the picture, ours are in half diagonals.
    grid = torch.stack(
        [
            (column * (1 + shift) * (2 * half_diagonal / width)),
            (row * (1 + shift) * (2 * half_diagonal / height)),
        ],
        dim=-1,
    )
    grid = grid.expand(len(photos), -1, -1, -1)
    return F.grid_sample(photos, grid, padding_mode="border", align_corners=False)


def with_motion_blur(photos: Photos, lengths_px: PerView, angles_rad: PerView) -> Photos:
    """Each photo averaged along a line of its own; a length of 0 leaves it as it is."""
    height = photos.shape[-2]
    blurred = []
    for photo, length_px, angle_rad in zip(photos, lengths_px, angles_rad, strict=True):
        kernel = torch.from_numpy(line_kernel(length_px * height / 128, angle_rad)).to(photo)
        margin = len(kernel) // 2
        padded = F.pad(photo[None], (margin,) * 4, mode="replicate")
        blurred.append(F.conv2d(padded, kernel.expand(3, 1, -1, -1), groups=3)[0])
    return torch.stack(blurred) if blurred else photos


def line_kernel(length_px: float, angle_rad: float) -> Float[np.ndarray, "size size"]:
    """Weights, of sum 1, of a line through the centre; columns to the right, rows down."""
    margin = int(np.ceil(max(length_px, 0.0) / 2))
    kernel = np.zeros((2 * margin + 3,) * 2, dtype=np.float32)  # one more pixel to spread into
    for t in np.linspace(-length_px / 2, length_px / 2, 8 * margin + 1):
        x, y = margin + 1 + t * np.cos(angle_rad), margin + 1 + t * np.sin(angle_rad)
        column, row = int(np.floor(x)), int(np.floor(y))
        right, down = x - column, y - row
        kernel[row : row + 2, column : column + 2] += np.outer([1 - down, down], [1 - right, right])
    return kernel / kernel.sum()


def with_noise(photos: Photos, dark: PerView, bright: PerView, rng: np.random.Generator) -> Photos:
    """Noise of a sensor, not clipped: its variance grows in a line with the value.

    Args:
        photos: Without noise.
        dark: Standard deviation where the value is 0.
        bright: And where it is 1.
        rng: Draws the noise.
    """
    low, high = (torch.from_numpy(s).to(photos).view(-1, 1, 1, 1) ** 2 for s in (dark, bright))
    sigma = (low + (high - low) * photos.clamp(0, 1)).sqrt()
    noise = rng.standard_normal(tuple(photos.shape), dtype=np.float32)
    return photos + sigma * torch.from_numpy(noise).to(photos)


def with_jpeg(photos: Photos, qualities: Sequence[int]) -> Photos:
    """Photos written as JPEG files of these qualities and read again; clipped to [0, 1] first."""
    pictures = (photos.clamp(0, 1) * 255).round().byte().permute(0, 2, 3, 1).cpu().numpy()
    read = [jpeg_round_trip(p, q) for p, q in zip(pictures, qualities, strict=True)]
    if not read:
        return photos
    return torch.from_numpy(np.stack(read)).to(photos).permute(0, 3, 1, 2).contiguous() / 255


def jpeg_round_trip(
    picture: UInt8[np.ndarray, "height width 3"], quality: int
) -> UInt8[np.ndarray, "height width 3"]:
    """The picture as its JPEG file of this quality shows it."""
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "JPEG", quality=quality)
    return np.array(Image.open(stream))


def _from_centre(
    photos: Photos,
) -> tuple[Float[Tensor, "height width"], Float[Tensor, "height width"], float]:
    """Rows and columns of the pixels from the centre in half diagonals, and half the diagonal."""
    height, width = photos.shape[-2:]
    half_diagonal = float(np.hypot(height, width)) / 2
    rows = (torch.arange(height).to(photos) + 0.5 - height / 2) / half_diagonal
    columns = (torch.arange(width).to(photos) + 0.5 - width / 2) / half_diagonal
    row, column = torch.meshgrid(rows, columns, indexing="ij")
    return row, column, half_diagonal
