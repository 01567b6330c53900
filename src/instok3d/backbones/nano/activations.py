"""Memory that the nano backbone takes while it runs, counted and held against measured peaks."""

from instok3d.backbones.cost import FLOAT, Activations, Work, geometry_bytes
from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.backbones.nano.matching import MATCH_STRIDE


def nano_activations(config: NanoConfig, work: Work) -> Activations:
    """Stem and depth head by the pixel, blocks by the token, matching by pairs of cells."""
    tokens = work.pixels // 64
    values = FLOAT * tokens * config.width
    cells = (work.height // MATCH_STRIDE) * (work.width // MATCH_STRIDE)
    matching = 3 * FLOAT * work.batch * cells**2 if work.views > 1 else 0
    result = 2 * values + geometry_bytes(work) + FLOAT * work.pixels // MATCH_STRIDE**2 * 64
    block = (18 * FLOAT + 16 * work.narrow) * tokens * config.width
    return Activations(
        peak=480 * work.pixels + max(14 * values, matching),
        stored=1_000 * work.pixels + 2 * config.layers * block,
        result=result,
    )
