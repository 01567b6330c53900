"""Sizes of VGGT."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from instok3d.backbones.base import BackboneConfig


@dataclass(frozen=True)
class VGGTConfig(BackboneConfig):
    """Sizes of VGGT and how its answer is read. The defaults are the public VGGT-1B's.

    Lists, as JSON gives them, become tuples.
    """

    img_size: int = 518
    """Image side, pixels, of the stored position embedding; other images interpolate it. The
    paper has 256 (Sec. 4)."""
    patch_size: int = 14
    """Side of a patch, pixels; the paper has 16 (Sec. 4)."""
    embed_dim: int = 1024
    """C, channels of a token."""
    depth: int = 24
    """Pairs of a frame block and a global block."""
    num_heads: int = 16
    """Attention heads of every block."""
    dino_depth: int = 24
    """Blocks of the image encoder, a DINOv2 ViT."""
    num_register_tokens: int = 4
    """Register tokens of each view, and as many again inside the image encoder."""
    camera_trunk_depth: int = 4
    """Blocks of the camera head."""
    dpt_features: int = 256
    """Channels in which the dense heads fuse their scales."""
    dpt_out_channels: Sequence[int] = (256, 512, 1024, 1024)
    """Channels of the four scales, the finest first."""
    dpt_layers: Sequence[int] = (4, 11, 17, 23)
    """Pairs of blocks whose outputs the dense heads read."""
    intrinsics_token: bool = False
    """One more token for each view, made from its intrinsics (Sec. 4); not in the public model."""
    geometry_from: Literal["points", "depths"] = "points"
    """What the pointmaps are: the point head's answer, as in the paper, or the depth head's
    unprojected from the camera head's cameras."""
    checkpoint_blocks: bool = False
    """Recompute blocks in the backward pass: a third more time, far less memory."""

    @property
    def image_side(self) -> int:
        """As its position embedding."""
        return self.img_size

    def __post_init__(self):
        for name in ("dpt_out_channels", "dpt_layers"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if self.img_size % self.patch_size:
            raise ValueError(
                f"img_size {self.img_size} is no multiple of patch_size {self.patch_size}"
            )
        if self.embed_dim % (4 * self.num_heads):
            raise ValueError(
                f"embed_dim {self.embed_dim} must be a multiple of 4 x num_heads "
                f"({4 * self.num_heads}), for the rotations of queries and keys"
            )
        if len(self.dpt_out_channels) != 4 or len(self.dpt_layers) != 4:
            raise ValueError(
                "dpt_out_channels and dpt_layers name four scales, got "
                f"{self.dpt_out_channels} and {self.dpt_layers}"
            )
        if self.dpt_features % 8 or any(each % 4 for each in self.dpt_out_channels):
            raise ValueError(
                "dpt_features must be a multiple of 8 and dpt_out_channels of 4, got "
                f"{self.dpt_features} and {self.dpt_out_channels}"
            )
        if not all(0 <= layer < self.depth for layer in self.dpt_layers):
            raise ValueError(f"dpt_layers {self.dpt_layers} must lie in 0 to {self.depth - 1}")


PAPER_VGGT = VGGTConfig(img_size=256, patch_size=16, intrinsics_token=True)
"""VGGT as the paper uses it (Sec. 4): 256 x 256 images, patches of 16, intrinsics as a token."""
