"""Whether a data set has what a stage learns from, seen before a run begins."""

import numpy as np

from instok3d.data.scenes import SceneFrames, SceneSource
from instok3d.training.config import TrainConfig
from instok3d.training.stages.adapt import AdaptStageConfig
from instok3d.training.stages.geometry import GeometryStageConfig
from instok3d.training.stages.tokenizer import TokenizerStageConfig

LOOKED_AT = 8
"""Scenes, spread over the data set, of which two frames are read."""


def check_scenes(config: TrainConfig, source: SceneSource) -> tuple[int, int]:
    """Fail where a scene lacks what the stage needs; gives height and width of the pictures.

    Raises:
        ValueError: No scene, pictures of several sizes, no instance ids for the tokenizer, or no
            depth for the geometry stage.
    """
    if len(source) == 0:
        raise ValueError("the data set has no scene of the training split")
    sizes = set()
    for number in np.unique(np.linspace(0, len(source) - 1, LOOKED_AT).astype(int)):
        last = source.num_frames(int(number)) - 1
        frames = source.frames(int(number), sorted({0, last // 2}) if last >= 0 else [])
        if len(frames.images):
            sizes.add(tuple(frames.images.shape[1:3]))
            _check_frames(config, frames)
    if len(sizes) != 1:
        raise ValueError(f"pictures must all have one size, the data set has {sorted(sizes)}")
    return sizes.pop()


def _check_frames(config: TrainConfig, frames: SceneFrames) -> None:
    stage = config.stage
    learns_groups = isinstance(stage, TokenizerStageConfig) and stage.seg_weight > 0
    if learns_groups and bool((frames.instances < 0).all()):
        raise ValueError(
            f"scene {frames.name} has no instance ids, which the grouping learns from: make masks "
            "with `instok3d data masks` and choose them with --masks, or set --stage.seg-weight 0"
        )
    aligned = isinstance(stage, AdaptStageConfig | TokenizerStageConfig) and (
        stage.target_cameras == "aligned" and stage.scale_from == "depths"
    )
    if (isinstance(stage, GeometryStageConfig) or aligned) and not (frames.depths_m > 0).any():
        raise ValueError(f"scene {frames.name} has no true depth, which this stage learns from")
