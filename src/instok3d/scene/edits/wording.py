"""Words of which the operations make theirs: keys of objects, holes, motions."""

import math
from collections.abc import Sequence

import torch

from instok3d.geometry.moving import Similarity
from instok3d.scene.edits.scene_objects import object_of
from instok3d.scene.record import SceneRecord
from instok3d.scene.run_lengths import RunLengths


def keys(scene: SceneRecord, ids: Sequence[int]) -> str:
    """Keys of objects, one after another."""
    return ", ".join(object_of(scene, number).key for number in ids)


def hole_words(hole: Sequence[RunLengths] | None) -> str:
    """The share of the input views that a hole takes; nothing where there is none."""
    area = sum(each.area for each in hole or ())
    if not hole or not area:
        return ""
    pixels = sum(each.height * each.width for each in hole)
    return f", which leaves a hole in {area / pixels:.2%} of the views"


def moved_words(scene: SceneRecord, number: int, motion: Similarity) -> str:
    """Key, way of the box's centre, turn and scale."""
    item = object_of(scene, number)
    center = torch.tensor([item.obb.center], dtype=torch.float64)
    way = [round(value, 6) + 0.0 for value in (motion.points(center) - center)[0].tolist()]
    w, *axis = motion.quat_wxyz
    length = math.hypot(*axis)
    about = ", ".join(f"{value / max(length, 1e-12) + 0.0:.3g}" for value in axis)
    angle = math.degrees(2 * math.atan2(length, w))
    words = [
        "by (" + ", ".join(f"{value:.4g}" for value in way) + ")" if any(way) else "",
        f"turned by {angle:.4g} degrees about ({about})" if length else "",
        f"times {motion.scale:.4g}" if motion.scale != 1 else "",
    ]
    return f"{item.key} " + (", ".join(each for each in words if each) or "not at all")
