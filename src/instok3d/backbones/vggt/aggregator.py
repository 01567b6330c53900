"""The trunk of VGGT: frame attention and global attention in turn."""

from collections.abc import Collection

import torch
from jaxtyping import Float
from torch import Tensor, nn

from instok3d.backbones.vggt.config import VGGTConfig
from instok3d.backbones.vggt.image_encoder import ImageEncoder
from instok3d.backbones.vggt.layers import Block, RotaryTable, rotary_table, run_block

IMAGE_MEAN = (0.485, 0.456, 0.406)
IMAGE_STD = (0.229, 0.224, 0.225)
LAYER_SCALE = 0.01


class Aggregator(nn.Module):
    """Images to multi-view tokens.

    Tokens of a view: camera, registers, patches in row-major order, and last the intrinsics where
    the config asks for them. Inside, that is; `forward` does not return the intrinsics token.
    """

    def __init__(self, config: VGGTConfig) -> None:
        super().__init__()
        self.config = config
        width = config.embed_dim
        self.patch_embed = ImageEncoder(config)
        # Number 0 is the first view's, which is the world; number 1 is every other view's.
        self.camera_token = nn.Parameter(torch.randn(1, 2, 1, width) * 1e-6)
        self.register_token = nn.Parameter(
            torch.randn(1, 2, config.num_register_tokens, width) * 1e-6
        )
        if config.intrinsics_token:
            self.embed_intrinsics = new_intrinsics_layer(width)
        self.frame_blocks = self._blocks()
        self.global_blocks = self._blocks()

    def _blocks(self) -> nn.ModuleList:
        width, heads = self.config.embed_dim, self.config.num_heads
        return nn.ModuleList(
            Block(width, heads, layer_scale=LAYER_SCALE, normalize_heads=True)
            for _ in range(self.config.depth)
        )

    @property
    def num_special_tokens(self) -> int:
        """Camera and register tokens, which stand before a view's patches."""
        return 1 + self.config.num_register_tokens

    def forward(
        self,
        images: Float[Tensor, "batch view 3 height width"],
        intrinsics: Float[Tensor, "batch view 3 3"] | None = None,
        *,
        layers: Collection[int],
    ) -> dict[int, Float[Tensor, "batch view token channel"]]:
        """Outputs of the chosen pairs of blocks: the frame block's channels, then the global's.

        Together these are 2 x embed_dim channels.

        Args:
            images: sRGB in [0, 1]; sides are multiples of the patch size.
            intrinsics: Pixels of these images; None is encoded as zeros. Ignored where the
                network has no intrinsics token.
            layers: Which pairs, 0 to depth - 1. Fewer take less memory, not less time.
        """
        views, _, height, width = images.shape[1:]
        patch = self.config.patch_size
        if height % patch or width % patch:
            raise ValueError(
                f"images are {height}x{width} pixels; this VGGT needs multiples of {patch}: "
                "resize or crop them"
            )
        tokens = self._embed(images, intrinsics)
        frame_table, global_table = self._tables(height // patch, width // patch, views, images)
        end = self.num_special_tokens + (height // patch) * (width // patch)
        outputs = {}
        for number, (frame_block, global_block) in enumerate(
            zip(self.frame_blocks, self.global_blocks, strict=True)
        ):
            frame = self._run(frame_block, tokens.flatten(0, 1), frame_table).view_as(tokens)
            tokens = self._run(global_block, frame.flatten(1, 2), global_table).view_as(tokens)
            if number in layers:
                outputs[number] = torch.cat([frame[:, :, :end], tokens[:, :, :end]], dim=-1)
        return outputs

    def _run(self, block: nn.Module, tokens: Tensor, table: RotaryTable) -> Tensor:
        assert isinstance(block, Block)
        return run_block(block, tokens, table, self.config.checkpoint_blocks)

    def _embed(self, images: Tensor, intrinsics: Tensor | None) -> Tensor:
        """All tokens before the first pair of blocks, [batch, view, token, channel]."""
        batch, views, _, height, width = images.shape
        images = images.to(self.camera_token.dtype)
        mean, std = (images.new_tensor(each)[:, None, None] for each in (IMAGE_MEAN, IMAGE_STD))
        patches = self.patch_embed(((images - mean) / std).flatten(0, 1))
        parts = [
            _first_and_others(self.camera_token, batch, views),
            _first_and_others(self.register_token, batch, views),
            patches.unflatten(0, (batch, views)),
        ]
        if self.config.intrinsics_token:
            if intrinsics is None:
                known = images.new_zeros(batch, views, 9)
            else:
                known = relative_intrinsics(intrinsics.to(images), height, width)
            parts.append(self.embed_intrinsics(known)[:, :, None])
        return torch.cat(parts, dim=2)

    def _tables(
        self, rows: int, columns: int, views: int, like: Tensor
    ) -> tuple[RotaryTable, RotaryTable]:
        """Rotations of one view's tokens and of all views' tokens.

        Camera and registers stand at (0, 0), the patches from (1, 1) on; the intrinsics stand
        below the first column.
        """
        y, x = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
        grid = torch.stack([y, x], dim=-1).flatten(0, 1) + 1
        positions = [torch.zeros(self.num_special_tokens, 2, dtype=torch.int64), grid]
        if self.config.intrinsics_token:
            positions.append(torch.tensor([[rows + 1, 1]]))
        table = rotary_table(
            torch.cat(positions).to(like.device), self.config.embed_dim // self.config.num_heads
        )
        return table, RotaryTable(*(each.repeat(views, 1, 1, 1) for each in table))


def new_intrinsics_layer(width: int) -> nn.Linear:
    """The linear layer on the intrinsics (Sec. 4): Kaiming-normal, no bias to begin with."""
    layer = nn.Linear(9, width)
    nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
    nn.init.zeros_(layer.bias)
    return layer


def relative_intrinsics(
    intrinsics: Float[Tensor, "*batch 3 3"], height: int, width: int
) -> Float[Tensor, "*batch 9"]:
    """Intrinsics as the network reads them: [fx/w, s/w, cx/w, 0, fy/h, cy/h, 0, 0, 1]."""
    size = intrinsics.new_tensor([width, height, 1])
    return (intrinsics / size[:, None]).flatten(-2)


def _first_and_others(token: Tensor, batch: int, views: int) -> Tensor:
    """One row for the first view, the other for all others, [batch, view, token, channel]."""
    others = token[:, 1:].expand(-1, views - 1, -1, -1)
    return torch.cat([token[:, :1], others], dim=1).expand(batch, -1, -1, -1)
