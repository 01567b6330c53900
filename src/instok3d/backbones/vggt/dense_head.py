"""The dense heads of VGGT (DPT): tokens of four depths of the trunk to one map at full size."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from instok3d.backbones.vggt.config import VGGTConfig

POSITION_SCALE = 0.1
POSITION_BASE = 100.0
IMAGES_AT_ONCE = 8
"""Images decoded together: each is decoded by itself, so that this only bounds the memory."""


class ResidualUnit(nn.Module):
    """Two convolutions and a skip.

    The skip carries relu(x), not x: the published weights were trained with a ReLU that works in
    place, so that the skip saw its result.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, channels, 3, padding=1)
        self.conv2 = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Float[Tensor, "image channel h w"]) -> Float[Tensor, "image channel h w"]:
        """Features of the same size."""
        x = x.relu()
        return self.conv2(self.conv1(x).relu()) + x


class FusionBlock(nn.Module):
    """Adds a finer scale and goes on to the next size."""

    def __init__(self, channels: int, *, has_skip: bool) -> None:
        super().__init__()
        if has_skip:
            self.resConfUnit1 = ResidualUnit(channels)
        self.resConfUnit2 = ResidualUnit(channels)
        self.out_conv = nn.Conv2d(channels, channels, 1)

    def forward(
        self,
        x: Float[Tensor, "image channel h w"],
        skip: Float[Tensor, "image channel h w"] | None,
        size: tuple[int, int],
    ) -> Float[Tensor, "image channel {size[0]} {size[1]}"]:
        """Features at the given size."""
        if skip is not None:
            x = x + self.resConfUnit1(skip)
        return self.out_conv(_resize(self.resConfUnit2(x), size))


class Scratch(nn.Module):
    """The convolutional part, named as in the published files."""

    def __init__(self, config: VGGTConfig, channels_out: int) -> None:
        super().__init__()
        width = config.dpt_features
        for number, channels in enumerate(config.dpt_out_channels, start=1):
            scale = nn.Conv2d(channels, width, 3, padding=1, bias=False)
            self.add_module(f"layer{number}_rn", scale)
        for number in range(1, 5):
            self.add_module(f"refinenet{number}", FusionBlock(width, has_skip=number < 4))
        self.output_conv1 = nn.Conv2d(width, width // 2, 3, padding=1)
        self.output_conv2 = nn.Sequential(
            nn.Conv2d(width // 2, 32, 3, padding=1), nn.ReLU(), nn.Conv2d(32, channels_out, 1)
        )

    def fuse(self, scales: Sequence[Tensor]) -> Float[Tensor, "image channel h w"]:
        """The four scales, the finest first, at twice the size of the finest."""
        layers = [self.get_submodule(f"layer{n}_rn")(x) for n, x in enumerate(scales, start=1)]
        sizes = [tuple(layer.shape[-2:]) for layer in layers]
        sizes.insert(0, (2 * sizes[0][0], 2 * sizes[0][1]))
        x = self.get_submodule("refinenet4")(layers[3], None, sizes[3])
        for number in (3, 2, 1):
            block = self.get_submodule(f"refinenet{number}")
            x = block(x, layers[number - 1], sizes[number - 1])
        return self.output_conv1(x)


class DenseHead(nn.Module):
    """Tokens to a map of `channels_out` raw channels at the size of the images."""

    def __init__(self, config: VGGTConfig, channels_out: int) -> None:
        super().__init__()
        self.config = config
        width, channels = 2 * config.embed_dim, config.dpt_out_channels
        self.norm = nn.LayerNorm(width)
        self.projects = nn.ModuleList(nn.Conv2d(width, each, 1) for each in channels)
        self.resize_layers = nn.ModuleList(
            [
                nn.ConvTranspose2d(channels[0], channels[0], 4, 4),
                nn.ConvTranspose2d(channels[1], channels[1], 2, 2),
                nn.Identity(),
                nn.Conv2d(channels[3], channels[3], 3, 2, 1),
            ]
        )
        self.scratch = Scratch(config, channels_out)

    def forward(
        self, layers: Sequence[Float[Tensor, "batch view patch channel"]], rows: int, columns: int
    ) -> Float[Tensor, "batch view height width {self.scratch.output_conv2[2].out_channels}"]:
        """The map, channels last.

        Args:
            layers: Patch tokens after the pairs of blocks `dpt_layers`, in that order.
            rows: Rows of patches.
            columns: Columns of patches.
        """
        batch, views = layers[0].shape[:2]
        chunks = zip(*(each.flatten(0, 1).split(IMAGES_AT_ONCE) for each in layers), strict=True)
        maps = torch.cat([self._decode(chunk, rows, columns) for chunk in chunks])
        return maps.permute(0, 2, 3, 1).unflatten(0, (batch, views))

    def _decode(self, layers: Sequence[Tensor], rows: int, columns: int) -> Tensor:
        aspect = columns / rows
        scales = []
        for tokens, project, resize in zip(layers, self.projects, self.resize_layers, strict=True):
            grid = self.norm(tokens).mT.unflatten(-1, (rows, columns))
            scales.append(resize(_add_positions(project(grid), aspect)))
        fused = self.scratch.fuse(scales)
        patch = self.config.patch_size
        fused = _resize(fused, (rows * patch, columns * patch))
        return self.scratch.output_conv2(_add_positions(fused, aspect))


def position_waves(
    rows: int, columns: int, channels: int, aspect: float, *, like: Tensor
) -> Float[Tensor, "{channels} {rows} {columns}"]:
    """Sines and cosines of where each cell lies: of x in the first half of the channels, then y.

    The centres of the cells span (n - 1)/n of a rectangle of this aspect (width / height) whose
    half diagonal is 1.
    """
    diagonal = (aspect**2 + 1) ** 0.5
    reach_x, reach_y = aspect / diagonal * (columns - 1) / columns, (rows - 1) / rows / diagonal
    x = torch.linspace(-reach_x, reach_x, columns, device=like.device, dtype=torch.float64)
    y = torch.linspace(-reach_y, reach_y, rows, device=like.device, dtype=torch.float64)
    exponents = torch.arange(channels // 4, device=like.device, dtype=torch.float64)
    frequencies = POSITION_BASE ** (-exponents / (channels // 4))
    waves = []
    for place in (x[None, :].expand(rows, -1), y[:, None].expand(-1, columns)):
        angles = frequencies[:, None, None] * place
        waves += [angles.sin(), angles.cos()]
    return torch.cat(waves).to(like.dtype)


def _add_positions(x: Tensor, aspect: float) -> Tensor:
    channels, rows, columns = x.shape[-3:]
    return x + POSITION_SCALE * position_waves(rows, columns, channels, aspect, like=x)


def _resize(x: Tensor, size: tuple[int, int]) -> Tensor:
    return functional.interpolate(x, size=size, mode="bilinear", align_corners=True)
