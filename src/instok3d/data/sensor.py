"""Random cameras: photos of one room differ in exposure, white balance, blur, noise and JPEG."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from torch import Tensor

from instok3d.data.photo_effects import (
    Photos,
    with_contrast,
    with_distortion,
    with_gains,
    with_jpeg,
    with_motion_blur,
    with_noise,
    with_saturation,
    with_vignette,
)


@dataclass(frozen=True)
class SensorConfig:
    """How far photos go from clean renders, beyond the change of light of `photometric`."""

    strength: float = 0.0
    """0 to 1: what every bound below is multiplied with. 0: no sensor, and nothing is drawn."""
    probability: float = 0.8
    """Share of the samples that go through the sensor; the others stay clean."""
    darkening: float = 1.4
    """Tone curve: values to the power of 1 plus up to this."""
    highlights: float = 0.2
    """Values from 1 minus up to this upward are white."""
    contrast: float = 0.2
    """Distance of values from their mean, times 1 plus or minus up to this."""
    saturation: float = 0.4
    """Distance of colours from their grey, times 1 plus or minus up to this."""
    exposure: float = 0.4
    """Values of a view, times 1 plus or minus up to this; 1 in the mean over the views."""
    white_balance: float = 0.1
    """Values of a view and colour, times 1 plus or minus up to this; likewise."""
    vignetting: float = 0.4
    """Light that the corners lose, up to; the same in all views."""
    distortion_px: float = 1.0
    """Radial distortion, which cameras and depth do not know: shift of the corners in pixels at a
    height of 128, up to; the same in all views. 0 where matches are learnt from true depth."""
    blur_px: float = 2.5
    """Length of the motion blur of a view in pixels at a height of 128, up to; half of the views
    have none."""
    dark_noise: float = 0.015
    """Standard deviation of a view's noise where it is black, up to."""
    bright_noise: float = 0.045
    """And where it is white; the variance lies on a line between."""
    worst_jpeg: int = 30
    """Lowest quality of a view's JPEG, of 30 to 95; the highest is 95."""

    def __post_init__(self):
        for name in ("strength", "probability", "exposure", "white_balance", "vignetting",
                     "highlights", "contrast", "saturation"):  # fmt: skip
            value = getattr(self, name)
            if not 0 <= value <= 1:
                raise ValueError(f"sensor.{name} must lie within 0 and 1, got {value}")
        for name in ("darkening", "distortion_px", "blur_px", "dark_noise", "bright_noise"):
            value = getattr(self, name)
            if not 0 <= value < np.inf:
                raise ValueError(f"sensor.{name} must be 0 or more, got {value}")
        if not 1 <= self.worst_jpeg <= _BEST_JPEG:
            raise ValueError(
                f"sensor.worst_jpeg must lie within 1 and {_BEST_JPEG}, got {self.worst_jpeg}"
            )


_BEST_JPEG = 95


def sensor_change(
    rng: np.random.Generator,
    config: SensorConfig,
    context: Float[Tensor, "context 3 height width"],
    target: Float[Tensor, "target 3 height width"],
) -> tuple[Float[Tensor, "context 3 height width"], Float[Tensor, "target 3 height width"]]:
    """Context photos as a random camera takes them, and the targets that they stand for.

    1. Contexts and targets: tone curve, highlights, contrast, saturation. They are one look of the
       room, which a render has to have too.
    2. Contexts alone: lens (distortion, vignette) and, for each view, motion, exposure, white
       balance, noise and JPEG. A render must not learn those. Exposure and white balance are 1
       in the mean over the views, so that the targets' brightness follows from the contexts.

    Args:
        rng: Of the sample; with strength 0 it is not touched and the images come back as they are.
        config: How strong.
        context: Photos in [0, 1].
        target: Likewise.
    """
    if config.strength == 0 or rng.random() >= config.probability:
        return context, target
    look = _look(rng, config, context)
    return _camera(rng, config, look(context)), look(target)


def _look(
    rng: np.random.Generator, config: SensorConfig, context: Photos
) -> Callable[[Photos], Photos]:
    """What all views share; the middle of the contrast is the mean of the contexts."""
    strength = config.strength
    power = 1 + strength * config.darkening * rng.random()
    white = 1 - strength * config.highlights * rng.random()
    contrast = 1 + strength * config.contrast * rng.uniform(-1, 1)
    saturation = 1 + strength * config.saturation * rng.uniform(-1, 1)

    def toned(photos: Photos) -> Photos:
        return (photos / white).clamp(0, 1) ** power

    middle = toned(context).mean()

    def look(photos: Photos) -> Photos:
        contrasted = with_contrast(toned(photos), contrast, middle)
        return with_saturation(contrasted, saturation).clamp(0, 1)

    return look


def _camera(rng: np.random.Generator, config: SensorConfig, photos: Photos) -> Photos:
    """What the lens does to all photos alike and the sensor to each of them."""
    strength, views = config.strength, len(photos)
    if config.distortion_px:
        shift_px = strength * config.distortion_px * rng.uniform(-1, 1)
        photos = with_distortion(photos, shift_px)
    moving = rng.random(views) < 0.5
    lengths_px = moving * strength * config.blur_px * rng.random(views)
    photos = with_motion_blur(photos, lengths_px, rng.uniform(0, np.pi, views))
    photos = with_vignette(photos, np.full(views, strength * config.vignetting * rng.random()))
    photos = with_gains(photos, 1 + strength * config.exposure * balanced(rng, views, 1))
    photos = with_gains(photos, 1 + strength * config.white_balance * balanced(rng, views, 3))
    amount = strength * rng.random(views)
    photos = with_noise(photos, amount * config.dark_noise, amount * config.bright_noise, rng)
    worst = _BEST_JPEG - strength * (_BEST_JPEG - config.worst_jpeg)
    qualities = rng.uniform(worst, _BEST_JPEG, views).round().astype(int)
    return with_jpeg(photos, qualities.tolist())


def balanced(
    rng: np.random.Generator, views: int, channels: int
) -> Float[np.ndarray, "{views} {channels}"]:
    """Random numbers within -1 and 1, of mean 0 over the views."""
    numbers = rng.uniform(-1, 1, (views, channels))
    numbers -= numbers.mean(axis=0, keepdims=True)
    return numbers / np.maximum(np.abs(numbers).max(axis=0, keepdims=True), 1) if views else numbers
