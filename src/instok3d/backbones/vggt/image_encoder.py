"""The image encoder of VGGT: a DINOv2 vision transformer with register tokens."""

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from instok3d.backbones.vggt.config import VGGTConfig
from instok3d.backbones.vggt.layers import Block, run_block

EPSILON = 1e-6
"""Of every layer norm of the encoder; the rest of VGGT has 1e-5."""


class PatchProjection(nn.Module):
    """One linear map for all patches."""

    def __init__(self, patch_size: int, width: int) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, width, patch_size, patch_size)

    def forward(
        self, images: Float[Tensor, "image 3 height width"]
    ) -> Float[Tensor, "image patch channel"]:
        """Patch tokens in row-major order."""
        return self.proj(images).flatten(2).mT


class ImageEncoder(nn.Module):
    """Normalised images to patch tokens, each image by itself."""

    def __init__(self, config: VGGTConfig) -> None:
        super().__init__()
        width = config.embed_dim
        self.patch_size = config.patch_size
        self.recompute = config.checkpoint_blocks
        self.patch_embed = PatchProjection(config.patch_size, width)
        self.cls_token = nn.Parameter(torch.randn(1, 1, width) * 1e-6)
        self.register_tokens = nn.Parameter(
            torch.randn(1, config.num_register_tokens, width) * 1e-6
        )
        # Stood for hidden patches in pretraining: nothing here reads it, but files hold it.
        self.mask_token = nn.Parameter(torch.zeros(1, width), requires_grad=False)
        patches = (config.img_size // config.patch_size) ** 2
        self.pos_embed = nn.Parameter(torch.randn(1, 1 + patches, width) * 0.02)
        self.blocks = nn.ModuleList(
            Block(width, config.num_heads, layer_scale=1.0, epsilon=EPSILON)
            for _ in range(config.dino_depth)
        )
        self.norm = nn.LayerNorm(width, eps=EPSILON)

    def forward(
        self, images: Float[Tensor, "image 3 height width"]
    ) -> Float[Tensor, "image patch channel"]:
        """Patch tokens in row-major order; class and register tokens stay inside."""
        rows, columns = (side // self.patch_size for side in images.shape[-2:])
        patches = self.patch_embed(images)
        count = len(patches)
        tokens = torch.cat([self.cls_token.expand(count, -1, -1), patches], dim=1)
        tokens = tokens + positions_for(self.pos_embed, rows, columns)
        registers = self.register_tokens.expand(count, -1, -1)
        tokens = torch.cat([tokens[:, :1], registers, tokens[:, 1:]], dim=1)
        for block in self.blocks:
            tokens = run_block(block, tokens, None, self.recompute)  # pyright: ignore[reportArgumentType]
        return self.norm(tokens)[:, 1 + registers.shape[1] :]


def positions_for(
    stored: Float[Tensor, "1 stored_token channel"], rows: int, columns: int
) -> Float[Tensor, "1 token channel"]:
    """The position embedding on another grid of patches, the class token's first and as it is.

    The stored grid is square. It is resized to `rows` x `columns` (bicubic, antialiased) unless
    it is that grid already. A constant embedding stays constant.
    """
    side = round((stored.shape[1] - 1) ** 0.5)
    if (rows, columns) == (side, side):
        return stored
    grid = stored[:, 1:].float().unflatten(1, (side, side)).permute(0, 3, 1, 2)
    resized = functional.interpolate(
        grid, size=(rows, columns), mode="bicubic", antialias=True, align_corners=False
    )
    return torch.cat([stored[:, :1].float(), resized.flatten(2).mT], dim=1).to(stored.dtype)
