"""A VGGT small enough for tests, as it comes out of the constructor with livelier weights."""

from dataclasses import replace

import torch

from instok3d.backbones.vggt import VGGT, VGGTConfig

TINY_VGGT = VGGTConfig(
    img_size=64, patch_size=16, embed_dim=32, depth=2, num_heads=2, dino_depth=1,
    num_register_tokens=2, camera_trunk_depth=1, dpt_features=16,
    dpt_out_channels=(8, 8, 16, 16), dpt_layers=(0, 0, 1, 1),
)  # fmt: skip


def tiny_vggt(**changes) -> VGGT:
    """The same network for the same sizes, in eval mode, in which every weight matters."""
    torch.manual_seed(0)
    return enlivened(VGGT(replace(TINY_VGGT, **changes))).eval()


def enlivened(module: VGGT) -> VGGT:
    """Without tokens and layer scales so small that nothing would be seen of them."""
    with torch.no_grad():
        for name, value in module.named_parameters():
            if name.endswith(("gamma", "_token", "_tokens", "pos_embed")):
                value.copy_(0.5 * torch.randn_like(value))
    return module
