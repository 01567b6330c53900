"""The image half of LSeg: a ViT-L/16 whose tokens of four depths a DPT head joins to one map.

Written anew from the published code's description; modules carry the names of the published
file's tensors.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

HEAD_SIZE = 64
"""Channels of an attention head, in the image encoder and in the text encoder."""


@dataclass(frozen=True)
class ImageSizes:
    """Sizes of the image half. The defaults are the published ones."""

    width: int = 1024
    """Channels of a token."""
    depth: int = 24
    """Blocks of the encoder; the head reads after each quarter of them."""
    patch: int = 16
    """Side of a patch, pixels."""
    grid: int = 24
    """Side of the stored position embedding, patches."""
    scale_channels: Sequence[int] = (256, 512, 1024, 1024)
    """Of the four scales, the finest first."""
    fused: int = 256
    """Channels in which scales are joined."""
    features: int = 512
    """D."""


class Attention(nn.Module):
    """Self-attention of the encoder."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.qkv = nn.Linear(width, 3 * width)
        self.proj = nn.Linear(width, width)

    def forward(self, x: Float[Tensor, "image token c"]) -> Float[Tensor, "image token c"]:
        """What the tokens gather from each other."""
        q, k, v = self.qkv(x).unflatten(2, (3, -1, HEAD_SIZE)).permute(2, 0, 3, 1, 4)
        gathered = functional.scaled_dot_product_attention(q, k, v)
        return self.proj(gathered.transpose(1, 2).flatten(2))


class Mlp(nn.Module):
    """The MLP of a block."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(width, 4 * width)
        self.fc2 = nn.Linear(4 * width, width)

    def forward(self, x: Float[Tensor, "image token c"]) -> Float[Tensor, "image token c"]:
        """Each token by itself."""
        return self.fc2(functional.gelu(self.fc1(x)))


class Block(nn.Module):
    """A block of the encoder, normalised before attention and MLP."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(width, eps=1e-6)
        self.attn = Attention(width)
        self.norm2 = nn.LayerNorm(width, eps=1e-6)
        self.mlp = Mlp(width)

    def forward(self, x: Float[Tensor, "image token c"]) -> Float[Tensor, "image token c"]:
        """The tokens after the block."""
        x = x + self.attn(self.norm1(x))
        return x + self.mlp(self.norm2(x))


class PatchEmbedding(nn.Module):
    """Patches to tokens."""

    def __init__(self, width: int, patch: int) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, width, patch, patch)


class Encoder(nn.Module):
    """The vision transformer."""

    def __init__(self, sizes: ImageSizes) -> None:
        super().__init__()
        self.sizes = sizes
        self.cls_token = nn.Parameter(torch.zeros(1, 1, sizes.width))
        self.pos_embed = nn.Parameter(torch.zeros(1, 1 + sizes.grid**2, sizes.width))
        self.patch_embed = PatchEmbedding(sizes.width, sizes.patch)
        self.blocks = nn.ModuleList(Block(sizes.width) for _ in range(sizes.depth))

    def forward(
        self, images: Float[Tensor, "image 3 height width"]
    ) -> list[Float[Tensor, "image token channel"]]:
        """Tokens after each quarter of the blocks; the class token is the first."""
        patches = self.patch_embed.proj(images)
        x = patches.flatten(2).mT
        x = torch.cat([self.cls_token.expand(len(x), -1, -1), x], dim=1)
        x = x + self._positions(*patches.shape[2:])
        outputs, quarter = [], len(self.blocks) // 4
        for number, block in enumerate(self.blocks, start=1):
            x = block(x)
            if number % quarter == 0:
                outputs.append(x)
        return outputs

    def _positions(self, rows: int, columns: int) -> Float[Tensor, "1 token channel"]:
        own, side = self.pos_embed[:, :1], self.sizes.grid
        grid = self.pos_embed[:, 1:].mT.unflatten(2, (side, side))
        grid = functional.interpolate(grid, (rows, columns), mode="bilinear")
        return torch.cat([own, grid.flatten(2).mT], dim=1)


class Readout(nn.Module):
    """Patch tokens that know the class token."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.project = nn.Sequential(nn.Linear(2 * width, width), nn.GELU())

    def forward(self, tokens: Float[Tensor, "image token c"]) -> Float[Tensor, "image patch c"]:
        """One token fewer."""
        patches = tokens[:, 1:]
        return self.project(torch.cat([patches, tokens[:, :1].expand_as(patches)], dim=2))


def _scale(width: int, channels: int, resize: nn.Module | None) -> nn.Module:
    """Tokens to one scale; 1 and 2, where the published file has no tensors, are not used."""
    scale = nn.Module()
    scale.add_module("0", Readout(width))
    scale.add_module("3", nn.Conv2d(width, channels, 1))
    scale.add_module("4", nn.Identity() if resize is None else resize)
    return scale


class Pretrained(nn.Module):
    """The encoder and what makes maps of four sizes out of its tokens."""

    def __init__(self, sizes: ImageSizes) -> None:
        super().__init__()
        self.model = Encoder(sizes)
        a, b, _, d = sizes.scale_channels
        resizes = [
            nn.ConvTranspose2d(a, a, 4, 4),
            nn.ConvTranspose2d(b, b, 2, 2),
            None,
            nn.Conv2d(d, d, 3, 2, 1),
        ]
        for number, resize in enumerate(resizes):
            channels = sizes.scale_channels[number]
            self.add_module(f"act_postprocess{number + 1}", _scale(sizes.width, channels, resize))

    def forward(
        self, images: Float[Tensor, "image 3 height width"]
    ) -> list[Float[Tensor, "image _channel _rows _columns"]]:
        """The four scales, the finest first: 4, 8, 16 and 32 pixels of the image to a cell."""
        patch = self.model.sizes.patch
        rows, columns = images.shape[2] // patch, images.shape[3] // patch
        scales = []
        for number, tokens in enumerate(self.model(images), start=1):
            part = self.get_submodule(f"act_postprocess{number}")
            read = part.get_submodule("0")(tokens).mT.unflatten(2, (rows, columns))
            scales.append(part.get_submodule("4")(part.get_submodule("3")(read)))
        return scales


class ResidualUnit(nn.Module):
    """Two convolutions and a skip, which carries what came in (the ReLU does not work in place)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        for number in (1, 2):
            self.add_module(f"conv{number}", nn.Conv2d(channels, channels, 3, 1, 1, bias=False))
            self.add_module(f"bn{number}", nn.BatchNorm2d(channels))

    def forward(self, x: Float[Tensor, "image c h w"]) -> Float[Tensor, "image c h w"]:
        """Features of the same size."""
        out = x
        for number in (1, 2):
            out = self.get_submodule(f"conv{number}")(out.relu())
            out = self.get_submodule(f"bn{number}")(out)
        return out + x


class FusionBlock(nn.Module):
    """Adds a finer scale, then doubles the size."""

    def __init__(self, channels: int, *, has_skip: bool) -> None:
        super().__init__()
        self.resConfUnit1 = ResidualUnit(channels) if has_skip else None
        self.resConfUnit2 = ResidualUnit(channels)
        self.out_conv = nn.Conv2d(channels, channels, 1)

    def forward(
        self, x: Float[Tensor, "image c h w"], skip: Float[Tensor, "image c h w"] | None
    ) -> Float[Tensor, "image c 2*h 2*w"]:
        """Features at twice the size."""
        if skip is not None:
            assert self.resConfUnit1 is not None
            x = x + self.resConfUnit1(skip)
        x = self.resConfUnit2(x)
        x = functional.interpolate(x, scale_factor=2, mode="bilinear", align_corners=True)
        return self.out_conv(x)


class Scratch(nn.Module):
    """The convolutional part."""

    def __init__(self, sizes: ImageSizes) -> None:
        super().__init__()
        width = sizes.fused
        for number, channels in enumerate(sizes.scale_channels, start=1):
            self.add_module(f"layer{number}_rn", nn.Conv2d(channels, width, 3, 1, 1, bias=False))
            self.add_module(f"refinenet{number}", FusionBlock(width, has_skip=number < 4))
        self.head1 = nn.Conv2d(width, sizes.features, 1)

    def forward(
        self, scales: Sequence[Float[Tensor, "image _channel _rows _columns"]]
    ) -> Float[Tensor, "image feature rows columns"]:
        """Features at twice the size of the finest scale, of any length."""
        x = None
        for number in (4, 3, 2, 1):
            skip = self.get_submodule(f"layer{number}_rn")(scales[number - 1])
            fuse = self.get_submodule(f"refinenet{number}")
            x = fuse(skip, None) if x is None else fuse(x, skip)
        return self.head1(x)
