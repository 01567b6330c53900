"""What it takes to run a backbone: asked of its sizes, before anything is loaded."""

from dataclasses import dataclass

import torch

FLOAT = 4
"""Bytes of a float32."""
CONVOLUTIONS_BYTES = 60_000_000
"""What the library of convolutions keeps for those of dense heads."""


@dataclass(frozen=True)
class Outline:
    """What others need to know of a network before it is there."""

    numbers: int
    """Parameters."""
    patch_size: int
    feature_channels: int


@dataclass(frozen=True)
class Work:
    """What a model is to do at once."""

    views: int
    """Of each scene."""
    height: int
    """Of a view, pixels."""
    width: int
    dtype: torch.dtype = torch.float32
    """Of autocast; weights stay in float32."""
    batch: int = 1
    """Scenes at once."""
    training: bool = False
    """Whether values are kept for the gradient, and gradients and moments for the optimizer."""
    frozen_backbone: bool = True
    """Training: whether the backbone learns nothing."""
    targets: int = 1
    """Training: views of each scene that are rendered."""
    lpips: bool = False
    """Training: whether renders are also compared by LPIPS, with VGG16."""
    cached_geometry: bool = False
    """Training: whether the backbone's answers are read from a disk, and it is not loaded."""

    @property
    def pixels(self) -> int:
        """Of all views of all scenes."""
        return self.batch * self.views * self.height * self.width

    @property
    def narrow(self) -> int:
        """Bytes of a number that a linear layer puts out."""
        return self.dtype.itemsize


@dataclass(frozen=True)
class Activations:
    """Bytes of values on their way through one part of a model."""

    peak: int
    """At the worst moment, when nothing is kept for a gradient."""
    stored: int
    """Kept for the gradient."""
    result: int
    """What the part hands on."""


def geometry_bytes(work: Work) -> int:
    """Depths, confidences and pointmaps, as they are put together."""
    return work.pixels * FLOAT * 12
