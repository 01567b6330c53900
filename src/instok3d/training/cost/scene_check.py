"""Whether a data set has what a stage learns from, seen before a run begins."""

import numpy as np

from instok3d.data.scenes import SceneFrames, SceneSource
from instok3d.training.config import TrainConfig

LOOKED_AT = 8
"""Scenes, spread over the data set, of which two frames are read."""


def check_scenes(config: TrainConfig, source: SceneSource) -> tuple[int, int]:
    """Fail where a scene lacks what the stage needs; gives height and width of the pictures.

    Raises:
        ValueError: No scene, pictures of several sizes, or instance ids or depth are missing that
            the stage learns from.
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
    needs = config.stage.data_needs()
    if needs.instances and bool((frames.instances < 0).all()):
        otherwise = f", or {needs.without_instances}" if needs.without_instances else ""
        raise ValueError(
            f"scene {frames.name} has no instance ids, which this stage learns from: make masks "
            f"with `instok3d data masks` and choose them with --masks{otherwise}"
        )
    if needs.depths and not (frames.depths_m > 0).any():
        raise ValueError(f"scene {frames.name} has no true depth, which this stage learns from")
