"""Which colours the objects of a scene show in its input views, as drawn: edits are in them."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.pictures import color_picture
from instok3d.rooms.seen_colors import NAMES, color_votes
from instok3d.scene.objects import SceneObject
from instok3d.semantics.query.ranking import COLOR_NAMES

if TYPE_CHECKING:
    from instok3d.scene.scene import Scene

FLOOR = 0.05
"""Share that every colour has besides: light and shadow change the name of a colour."""


@torch.no_grad()
def seen_color_shares(
    scene: "Scene", objects: Sequence[SceneObject]
) -> Float[Tensor, "object color"] | None:
    """Share of the pixels of each object that each of COLOR_NAMES has, FLOOR at least.

    Equal shares of an object that no input view shows.

    Args:
        scene: Drawn from its input views; None comes out where it has none.
        objects: Of the scene.
    """
    if not scene.views:
        return None
    pictures = color_picture(scene.render().colors)
    ids = np.zeros(pictures.shape[:3], np.int64)
    for item in objects:
        for view, mask in zip(item.visible_in, item.sight.masks, strict=True):
            ids[view][mask.mask().numpy()] = item.id
    votes = color_votes(pictures, ids)
    order = [NAMES.index(name) for name in COLOR_NAMES]
    shares = torch.full((len(objects), len(COLOR_NAMES)), 1 / len(COLOR_NAMES))
    for row, item in enumerate(objects):
        if item.id in votes:
            own = votes[item.id][order]
            shares[row] = torch.from_numpy(own / own.sum()).float()
    return shares + FLOOR
