"""A contact sheet of rooms: colours, instances and depth."""

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw

from instok3d.rooms.dataset import RoomDataset, RoomScene

PALETTE = np.random.default_rng(3).integers(40, 256, (4096, 3)).astype(np.uint8)
"""Colour of every instance id; the same id may have the same colour as another."""
PALETTE[0] = 0
CAPTION_HEIGHT = 16
"""Pixels of the line of text above each scene."""

Picture = UInt8[np.ndarray, "height width 3"]


def _strip(frames: np.ndarray) -> np.ndarray:
    return np.concatenate(list(frames), axis=1)


def _caption(scene: RoomScene, width: int) -> Picture:
    objects = sum(not record["stuff"] for record in scene.meta["instances"])
    text = f"seed {scene.seed}, {scene.level} {scene.meta['room_type']}, {objects} objects"
    line = Image.new("RGB", (width, CAPTION_HEIGHT))
    ImageDraw.Draw(line).text((3, 2), text, fill=(255, 255, 255))
    return np.array(line)


def scene_rows(scene: RoomScene, views: int) -> Picture:
    """A caption over three rows: `views` frames in colour, by instance, and by depth.

    The farthest depth of the scene is white.
    """
    chosen = np.linspace(0, len(scene.images) - 1, views).round().astype(int)
    instances = PALETTE[scene.instances[chosen].numpy() % len(PALETTE)]
    depths_m = scene.depths_m[chosen].numpy()
    grey = (depths_m / max(float(depths_m.max()), 1e-3) * 255).astype(np.uint8)
    depths = np.repeat(grey[..., None], 3, axis=-1)
    rows = [_strip(x) for x in (scene.images[chosen].numpy(), instances, depths)]
    return np.concatenate([_caption(scene, rows[0].shape[1]), *rows])


def contact_sheet(dataset: RoomDataset, scenes: int = 6, views: int = 8) -> Picture:
    """A caption and three rows for each of some scenes, spread evenly over the data set.

    Raises:
        ValueError: The data set is empty, or no scenes or views are asked for.
    """
    if scenes < 1 or views < 1:
        raise ValueError(f"a preview needs 1 or more scenes and views, got {scenes} and {views}")
    if len(dataset) == 0:
        raise ValueError(f"no finished rooms in {dataset.folder} to preview")
    numbers = np.linspace(0, len(dataset) - 1, min(scenes, len(dataset))).round().astype(int)
    return np.concatenate([scene_rows(dataset.scene(int(n)), views) for n in numbers])
