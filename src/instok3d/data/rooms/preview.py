"""A contact sheet of rooms: colours, instances and depth."""

import numpy as np
from jaxtyping import UInt8

from instok3d.data.rooms.dataset import RoomDataset, RoomScene

PALETTE = np.random.default_rng(3).integers(40, 256, (4096, 3)).astype(np.uint8)
"""Colour of every instance id; the same id may have the same colour as another."""
PALETTE[0] = 0
FAR_M = 6.0
"""Depth that is drawn white."""


def _strip(frames: np.ndarray) -> np.ndarray:
    return np.concatenate(list(frames), axis=1)


def scene_rows(scene: RoomScene, views: int) -> UInt8[np.ndarray, "height width 3"]:
    """Three rows for one scene: `views` frames in colour, by instance, and by depth."""
    chosen = np.linspace(0, len(scene.images) - 1, views).round().astype(int)
    instances = PALETTE[scene.instances[chosen].numpy() % len(PALETTE)]
    grey = np.clip(scene.depths_m[chosen].numpy() / FAR_M * 255, 0, 255).astype(np.uint8)
    depths = np.repeat(grey[..., None], 3, axis=-1)
    return np.concatenate([_strip(x) for x in (scene.images[chosen].numpy(), instances, depths)])


def contact_sheet(
    dataset: RoomDataset, scenes: int = 6, views: int = 8
) -> UInt8[np.ndarray, "height width 3"]:
    """Three rows for each of some scenes, spread evenly over the data set.

    Raises:
        ValueError: The data set is empty.
    """
    if len(dataset) == 0:
        raise ValueError(f"no finished rooms in {dataset.folder} to preview")
    numbers = np.linspace(0, len(dataset) - 1, min(scenes, len(dataset))).round().astype(int)
    return np.concatenate([scene_rows(dataset.scene(int(n)), views) for n in numbers])
