"""The paper's figure of edits: one object alone, taken away, moved, and put into another scene."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from instok3d.evaluation.query_rooms import scene_of_photos
from instok3d.model.tokenizer import Tokenizer
from instok3d.pictures import color_picture
from instok3d.scene.edits.placing import base_of_object
from instok3d.scene.objects import SceneObject
from instok3d.scene.scene import Scene

TITLES = ("photo", "rendered", "object alone", "removed", "moved", "inserted")
MOST = 0.2
"""Of a picture: what covers more of its best view is a wall or a floor, not a thing to move."""
LEAST_PIXELS = 64
"""Smaller things would hardly be seen in the figure."""
AWAY = 0.8
"""Of an object's length: how far into the picture it is moved, and another one is put."""

Picture = UInt8[np.ndarray, "height width 3"]


@torch.no_grad()
def edited_scenes(
    tokenizer: Tokenizer, rooms: Sequence[Float[Tensor, "view 3 height width"]]
) -> list[list[Picture]]:
    """A row of pictures by TITLES for each room, from bare photos in one forward pass.

    Scenes are drawn at the context view that shows most of the object. The object that is inserted
    is that of the next room. Rooms in which nothing of the size of a thing was found are left out.

    Args:
        tokenizer: In eval mode.
        rooms: Context photos of each.
    """
    found = []
    for photos in rooms:
        scene = scene_of_photos(photos, tokenizer)
        if (item := _largest_thing(scene)) is not None:
            found.append((photos, scene, item))
    return [
        _edited(photos, scene, item, *found[(number + 1) % len(found)][1:])
        for number, (photos, scene, item) in enumerate(found)
    ]


def _largest_thing(scene: Scene) -> SceneObject | None:
    """The object that covers most of a view that shows it whole; None without one.

    It covers no more than MOST of the view; what a border cuts is a part, mostly of a wall.
    """
    things = []
    for item in scene.objects:
        if (best := item.best_view) is None:
            continue
        x0, y0, x1, y1 = best.bbox
        is_whole = x0 > 0 and y0 > 0 and x1 < scene.width and y1 < scene.height
        if is_whole and LEAST_PIXELS <= best.pixels <= MOST * scene.height * scene.width:
            things.append((best.pixels, -item.id, item))
    return max(things)[2] if things else None


def _edited(
    photos: Float[Tensor, "view 3 height width"],
    scene: Scene,
    item: SceneObject,
    other: Scene,
    guest: SceneObject,
) -> list[Picture]:
    assert item.best_view is not None
    view, (x0, _, x1, _) = item.best_view.view, item.best_view.bbox
    to_the_right = scene.cameras.cam_from_world[view, 0, :3].double()
    inwards = 1 if x0 + x1 < scene.width else -1
    step = inwards * AWAY * max(item.obb.size) * to_the_right
    center = torch.tensor(base_of_object(scene, item), dtype=torch.float64)

    def drawn(shown: Scene, only: int | None = None) -> Picture:
        background = (0.0, 0.0, 0.0) if only is None else (1.0, 1.0, 1.0)
        return color_picture(shown.render([view], only=only, background=background).colors[0])

    return [
        color_picture(photos[view]),
        drawn(scene),
        drawn(scene, only=item.id),
        drawn(scene.remove(item.id)),
        drawn(scene.move(item.id, by=step.tolist())),
        drawn(scene.insert(other, guest.id, at=(center + step).tolist(), scale=1.0)),
    ]
