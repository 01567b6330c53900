"""Text features of every pixel from one photo alone: the network of the embedded teacher."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from instok3d.backbones.nano.layers import SelfAttentionBlock, Stem, Unshuffle
from instok3d.geometry.cameras import pixel_centers

PATCH = 8
"""Sides of photos are multiples of it."""
STRIDE = 2
"""Pixels of the photo in one cell of the features, each way."""


@dataclass(frozen=True)
class PredictorConfig:
    """Sizes of the predictor."""

    channels: int = 256
    """Of the text space."""
    width: int = 256
    """Channels of a token."""
    layers: int = 4
    """Attention blocks."""
    head_width: int = 64
    """Channels of an attention head."""
    quarter_channels: int = 128
    """Of the features at a quarter of the photo's size."""
    half_channels: int = 96
    """Of the features at half of it."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value < 1:
                raise ValueError(f"{name} must be at least 1, got {value}")


@dataclass(frozen=True)
class EncodedPhotos:
    """What the predictor makes of photos, each alone."""

    tokens: Float[Tensor, "view patch channel"]
    """Of squares of PATCH pixels, row-major, normalised."""
    features: Float[Tensor, "view feature row column"]
    """Of each cell of STRIDE x STRIDE pixels, of any length."""


class Predictor(nn.Module):
    """A convolutional stem, attention over the patches, and two steps of upsampling with detail.

    Stem and blocks are those of the nano backbone, whose frame and global blocks are the same
    thing where there is one view.
    """

    def __init__(self, config: PredictorConfig) -> None:
        super().__init__()
        self.config = config
        self.stem = Stem(config.width)
        self.embed_position = nn.Linear(16, config.width)
        self.blocks = nn.ModuleList(
            SelfAttentionBlock(config.width, config.head_width) for _ in range(config.layers)
        )
        self.norm = nn.LayerNorm(config.width)
        self.to_quarter = Unshuffle(config.width, 96, config.quarter_channels)
        self.to_half = Unshuffle(config.quarter_channels, 48, config.half_channels)
        self.out = nn.Conv2d(config.half_channels, config.channels, 1)

    def forward(
        self, images: Float[Tensor, "view 3 height width"]
    ) -> Float[Tensor, "view channel row column"]:
        """Features of each cell of STRIDE x STRIDE pixels, of any length.

        Args:
            images: sRGB in [0, 1], sides multiples of PATCH.
        """
        return self.encode(images).features

    def encode(self, images: Float[Tensor, "view 3 height width"]) -> EncodedPhotos:
        """The same features, and the tokens of the patches from which they were made.

        Args:
            images: See `forward`.
        """
        inputs = (images * 2 - 1).contiguous(memory_format=torch.channels_last)
        half, quarter, eighth = self.stem(inputs)
        rows, columns = eighth.shape[-2:]
        tokens = eighth.flatten(2).mT + self.embed_position(_waves(rows, columns, images))
        for block in self.blocks:
            tokens = block(tokens)
        tokens = self.norm(tokens)
        grid = tokens.mT.unflatten(2, (rows, columns))
        features = self.out(self.to_half(self.to_quarter(grid, quarter), half))
        return EncodedPhotos(tokens, features)

    def start_from_nano(self, weights: Mapping[str, Tensor]) -> None:
        """Take the encoder's weights of a nano backbone of the same width.

        Args:
            weights: Of the backbone, by name.

        Raises:
            KeyError: A weight is missing.
        """
        pairs = [f"{kind}_blocks.{k}" for k in range(len(self.blocks)) for kind in KINDS]
        starts = {"stem.": "stem.", "embed_position.": "embed_position."} | {
            f"blocks.{number}.": f"{pairs[number]}." for number in range(len(self.blocks))
        }
        with torch.no_grad():
            for name, value in self.state_dict().items():
                for own, theirs in starts.items():
                    if name.startswith(own):
                        value.copy_(weights[theirs + name.removeprefix(own)])
            # Tokens of photos of unknown focal length have this added, as bare photos do here.
            self.embed_position.bias.add_(weights["unknown_ray"])


KINDS = ("frame", "global")
"""Of the blocks of the nano backbone, in turn."""


def classification(
    features: Float[Tensor, "*view channel row column"],
    phrases: Float[Tensor, "phrase channel"],
) -> Float[Tensor, "*view phrase row column"]:
    """The cosine of every cell's feature with every phrase, whose vectors have unit length."""
    directions = functional.normalize(features, dim=-3)
    return torch.einsum("...chw,pc->...phw", directions, phrases)


def _waves(
    rows: int, columns: int, images: Float[Tensor, "view 3 height width"]
) -> Float[Tensor, "patch wave"]:
    """Where each patch lies, as the nano backbone says it."""
    height, width = images.shape[-2:]
    centers = pixel_centers(rows, columns, like=images) * PATCH
    middle = torch.tensor([0.5 * width, 0.5 * height], device=images.device)
    relative = (centers - middle) / (0.5 * max(height, width))
    waves = [relative * (torch.pi / 2) * 2**octave for octave in range(4)]
    return torch.cat([f(wave) for wave in waves for f in (torch.sin, torch.cos)], dim=-1).flatten(
        0, 1
    )
