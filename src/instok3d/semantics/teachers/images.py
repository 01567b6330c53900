"""What teachers do alike with images and features."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

IMAGES_AT_ONCE = 4
"""Images that a teacher looks at together: each by itself, so that this only bounds the memory."""


def in_parts(look: Callable[[Tensor], Tensor], images: Tensor, size: int) -> Tensor:
    """What a function gives for all images, called with so many at a time.

    Raises:
        ValueError: There is no image.
    """
    if not images.numel():
        raise ValueError(f"there is nothing to look at: images of shape {tuple(images.shape)}")
    return torch.cat([look(part) for part in images.split(size)])


def resized(
    images: Float[Tensor, "view 3 _height _width"], height: int, width: int
) -> Float[Tensor, "view 3 {height} {width}"]:
    """Images in [0, 1] of that size, smoothed where they shrink."""
    if images.shape[2:] == (height, width):
        return images
    smooth = functional.interpolate(images, (height, width), mode="bicubic", antialias=True)
    return smooth.clamp(0, 1)  # bicubic weights may be negative


def unit(features: Float[Tensor, "row channel *pixel"]) -> Float[Tensor, "row channel *pixel"]:
    """Features of unit length."""
    return functional.normalize(features, dim=1)
