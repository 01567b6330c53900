"""From radiance to 8-bit pictures: tone curve, and what a cheap camera adds."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from scipy.ndimage import gaussian_filter

from instok3d.data.photo_effects import jpeg_round_trip

Picture = UInt8[np.ndarray, "height width 3"]


LUMA = np.array([0.299, 0.587, 0.114], np.float32)
"""Weights of red, green and blue."""


def developed(
    radiance: Float[np.ndarray, "*frame height width 3"], exposure: float, contrast: float = 0.0
) -> UInt8[np.ndarray, "*frame height width 3"]:
    """SRGB bytes through a shoulder that keeps highlights, and an S-curve of some weight."""
    x = radiance * np.float32(exposure)
    x = np.clip(1.25 * x * (1 + x / 9) / (1 + x), 0, 1) ** np.float32(1 / 2.2)
    if contrast:
        x += np.float32(contrast) * (x * x * (3 - 2 * x) - x)
    return (x * 255 + 0.5).astype(np.uint8)


def exposure_for(
    radiance: Float[np.ndarray, "*frame height width 3"], mean_luma: float, contrast: float
) -> float:
    """The exposure that gives pictures a mean luma, by bisection; bounded where none does."""
    low, high = -12.0, 12.0
    for _ in range(16):
        middle = (low + high) / 2
        luma = float((developed(radiance, 2**middle, contrast) @ LUMA).mean()) / 255
        low, high = (middle, high) if luma < mean_luma else (low, middle)
    return 2 ** ((low + high) / 2)


@dataclass(frozen=True)
class Sensor:
    """A camera's faults, the same for all frames of a scene."""

    blur_px: float
    """Standard deviation of the blur at 128 pixels of height."""
    noise: float
    """Standard deviation of the noise, of full scale."""
    quality: int
    """JPEG."""

    @staticmethod
    def draw(rng: np.random.Generator) -> "Sensor":
        """Some camera."""
        blur, noise = float(rng.uniform(0.0, 0.6)), float(rng.uniform(0.002, 0.015))
        return Sensor(blur, noise, int(rng.integers(70, 97)))

    def apply(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """The picture as this camera takes it."""
        sigma = self.blur_px * picture.shape[0] / 128
        x = gaussian_filter(picture.astype(np.float32), (sigma, sigma, 0))
        x += rng.standard_normal(x.shape, np.float32) * np.float32(255 * self.noise)
        return jpeg_round_trip(np.clip(x + 0.5, 0, 255).astype(np.uint8), self.quality)
