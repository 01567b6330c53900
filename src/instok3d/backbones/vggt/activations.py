"""Memory that VGGT takes while it runs, counted and held against measured peaks."""

from instok3d.backbones.cost import (
    CONVOLUTIONS_BYTES,
    FLOAT,
    Activations,
    Work,
    geometry_bytes,
)
from instok3d.backbones.vggt.config import VGGTConfig
from instok3d.backbones.vggt.dense_head import IMAGES_AT_ONCE


def vggt_activations(config: VGGTConfig, work: Work) -> Activations:
    """Trunk by the token; dense heads by the pixel of the images that they decode at once."""
    patches = (work.height // config.patch_size) * (work.width // config.patch_size)
    special = 1 + config.num_register_tokens + config.intrinsics_token
    tokens = work.batch * work.views * (patches + special)
    values = FLOAT * tokens * config.embed_dim
    kept = 2 * len({*config.dpt_layers, config.depth - 1}) * values
    at_once = min(work.batch * work.views, IMAGES_AT_ONCE) * work.height * work.width
    dense = CONVOLUTIONS_BYTES + at_once * FLOAT * (3 * config.dpt_features // 2 + 64)
    block = (20 * FLOAT + 14 * work.narrow) * tokens * config.embed_dim
    blocks = config.dino_depth + 2 * config.depth
    every_image = work.pixels * FLOAT * (6 * config.dpt_features // 2 + 128)
    return Activations(
        peak=26 * values + kept + dense,
        stored=(blocks * values + block if config.checkpoint_blocks else blocks * block)
        + kept
        + 2 * every_image,
        result=2 * values + geometry_bytes(work),
    )
