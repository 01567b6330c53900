"""A contact sheet of rooms: colours, instances and depth."""

import numpy as np
from PIL import Image

from instok3d.pictures import Section, contact_sheet, depth_picture, id_picture
from instok3d.reading import naming_damage
from instok3d.rooms.dataset import RoomDataset, RoomScene
from instok3d.rooms.shards import SHARD_REMEDY


def scene_sections(scene: RoomScene, views: int) -> list[Section]:
    """Three rows under a caption: `views` frames in colour, by instance, and by depth."""
    chosen = np.linspace(0, len(scene.images) - 1, views).round().astype(int)
    with naming_damage(f"what is known of the room of seed {scene.seed}", SHARD_REMEDY):
        objects = sum(not record["stuff"] for record in scene.meta["instances"])
        caption = f"seed {scene.seed}, {scene.level} {scene.meta['room_type']}, {objects} objects"
    depths_m = scene.depths_m[chosen]
    grey = depth_picture(depths_m, farthest=max(float(depths_m.max()), 1e-3))
    return [
        Section(caption, list(scene.images[chosen].numpy())),
        Section("", list(id_picture(scene.instances[chosen]))),
        Section("", list(grey)),
    ]


def rooms_sheet(dataset: RoomDataset, scenes: int = 6, views: int = 8) -> Image.Image:
    """A caption and three rows for each of some scenes, spread evenly over the data set.

    Raises:
        ValueError: The data set is empty, or no scenes or views are asked for.
    """
    if scenes < 1 or views < 1:
        raise ValueError(f"a preview needs 1 or more scenes and views, got {scenes} and {views}")
    if len(dataset) == 0:
        raise ValueError(f"no finished rooms in {dataset.folder} to preview")
    numbers = np.linspace(0, len(dataset) - 1, min(scenes, len(dataset))).round().astype(int)
    sections = [part for n in numbers for part in scene_sections(dataset.scene(int(n)), views)]
    return contact_sheet(sections, columns=views)
