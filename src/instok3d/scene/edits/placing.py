"""Where an object stands: its base, the surface below it, and how it comes into another world."""

import math
import warnings
from collections.abc import Sequence

import torch

from instok3d.geometry.moving import (
    NO_TURN,
    Point,
    Quaternion,
    Similarity,
    quat_about,
)
from instok3d.geometry.rotations import quat_multiply
from instok3d.scene.boxes import extent_along
from instok3d.scene.edits.ownership import part_of
from instok3d.scene.objects import SceneObject
from instok3d.scene.record import SceneRecord
from instok3d.types import Gaussians

SUPPORT_SHARE = 0.9
"""Share of a surface's opacity that lies below where things stand on it."""


def base_of(gaussians: Gaussians, center: Point, up: Point) -> Point:
    """The point below the centre of an object's box, at the object's lower end along up.

    Args:
        gaussians: Of the object, at least one.
        center: Of its box.
        up: Of their world, unit length.
    """
    low, _ = extent_along(gaussians, up)
    axis, at = torch.tensor(up, dtype=torch.float64), torch.tensor(center, dtype=torch.float64)
    x, y, z = (at + (low - at @ axis) * axis).tolist()
    return x, y, z


def base_of_object(scene: SceneRecord, item: SceneObject) -> Point:
    """`base_of` an object of a scene, by its up."""
    return base_of(part_of(scene, item).gaussians, item.obb.center, scene.vertical.up)


def standing_on(scene: SceneRecord, surface: SceneObject, at: Point, radius: float) -> Point:
    """The place above or below a point where a surface carries things.

    Args:
        scene: Whose up counts.
        surface: A floor, a table.
        at: Any point on the vertical.
        radius: Of what is to stand there, scene units.

    Raises:
        ValueError: The surface has nothing within the radius.
    """
    up = torch.tensor(scene.vertical.up, dtype=torch.float64)
    gaussians = part_of(scene, surface).gaussians
    away = gaussians.means.double() - torch.tensor(at, dtype=torch.float64)
    level = (away - (away @ up)[:, None] * up).norm(dim=1) <= radius
    if not level.any():
        raise ValueError(
            f"{surface.key} has no surface above or below {_words(at)}: give another place or "
            "another object to stand on"
        )
    heights, order = (gaussians.means[level].double() @ up).sort()
    weights = gaussians.opacities[level].double().clamp_min(1e-6)[order]
    share = weights.cumsum(0) / weights.sum()
    height = heights[min(int((share < SUPPORT_SHARE).sum()), len(heights) - 1)]
    point = torch.tensor(at, dtype=torch.float64)
    x, y, z = (point + (height - point @ up) * up).tolist()
    return x, y, z


def scale_between(source: SceneRecord, target: SceneRecord) -> float:
    """Units of the target in one of the source: 1 where both are metres.

    Otherwise the scenes are taken to be equally large: what lies between near and far.
    """
    if source.units == target.units == "metres" or source.near_far == target.near_far:
        return 1.0
    warnings.warn(
        "the scenes' units are not known to be the same: the object is scaled as if both scenes "
        "were equally large; give a scale to set it",
        stacklevel=4,
    )
    return target.near_far[0] / source.near_far[0]


def upright_between(source: SceneRecord, target: SceneRecord) -> Quaternion:
    """The smallest turn that takes the source's up to the target's; none where one is unknown."""
    if not (source.vertical.is_stated and target.vertical.is_stated):
        warnings.warn(
            "which way is up is not known in both scenes: the object is not turned upright",
            stacklevel=4,
        )
        return NO_TURN
    return turn_between(source.vertical.up, target.vertical.up)


def turn_between(first: Point, second: Point) -> Quaternion:
    """The smallest rotation that takes one direction of unit length to another."""
    a = torch.tensor(first, dtype=torch.float64)
    b = torch.tensor(second, dtype=torch.float64)
    a, b = a / a.norm(), b / b.norm()
    cosine = float((a @ b).clamp(-1, 1))
    axis = torch.linalg.cross(a, b)
    if float(axis.norm()) < 1e-9:
        if cosine > 0:
            return NO_TURN
        axis = torch.linalg.cross(a, torch.eye(3, dtype=torch.float64)[int(a.abs().argmin())])
    angle_rad = math.atan2(float(torch.linalg.cross(a, b).norm()), cosine)
    return quat_about((axis / axis.norm()).tolist(), angle_rad)


def into_world(
    base: Point, up_turn: Quaternion, target_up: Point, at: Point, *, scale: float, yaw_rad: float
) -> Similarity:
    """The similarity that puts an object's base at a place, upright, turned about up."""
    yaw = torch.tensor(quat_about(target_up, yaw_rad), dtype=torch.float64)
    turn = quat_multiply(yaw, torch.tensor(up_turn, dtype=torch.float64)).tolist()
    quat = NO_TURN if yaw_rad == 0 and up_turn == NO_TURN else turn
    by = [there - here for there, here in zip(at, base, strict=True)]
    return Similarity.about(base, quat_wxyz=quat, scale=scale, by=by)


def _words(point: Sequence[float]) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in point) + ")"
