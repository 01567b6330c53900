"""Boxes of objects that stand upright, for sizes and places: along up and two level axes."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.rotations import quat_to_matrix
from instok3d.scene.boxes import Point, extents_along
from instok3d.scene.objects import SceneObject
from instok3d.scene.record import SceneRecord
from instok3d.semantics.query.relations import UprightBoxes

STEPS = 18
"""Turns of the level axes that are tried, of the quarter turn after which boxes are the same."""


def upright_boxes(scene: SceneRecord, objects: Sequence[SceneObject]) -> UprightBoxes:
    """The boxes of some of a scene's objects, in their order, scene units.

    All have the same level axes: those along which the objects' own boxes have the smallest sides,
    which in a room are those of its walls. Boxes reach as far as those of `describe_shape`.
    """
    axes = level_axes(objects, scene.vertical.up)
    low, high = torch.zeros(len(objects), 3), torch.zeros(len(objects), 3)
    for row, item in enumerate(objects):
        start, count = item.gaussian_range
        own = scene.gaussians.rows(slice(start, start + count))
        low[row], high[row] = (end.float() for end in extents_along(own, axes))
    return UprightBoxes(low, high)


def level_axes(objects: Sequence[SceneObject], up: Point) -> Float[Tensor, "3 3"]:
    """Two level axes and up as columns: world_from_upright, right-handed.

    Args:
        objects: By whose oriented boxes the level axes are turned; any turn without objects.
        up: Unit length.
    """
    third = torch.tensor(up, dtype=torch.float64)
    least = torch.eye(3, dtype=torch.float64)[int(third.abs().argmin())]
    first = least - (least @ third) * third
    first = first / first.norm()
    second = torch.linalg.cross(third, first)
    halves = [_half_axes(item) for item in objects]
    best, best_cost = 0.0, math.inf
    for step in range(STEPS):
        turn = step * math.pi / 2 / STEPS
        level = torch.stack([
            math.cos(turn) * first + math.sin(turn) * second,
            math.cos(turn) * second - math.sin(turn) * first,
        ])  # fmt: skip
        # Half lengths of a turned box along a direction: the sum of those of its half axes.
        cost = sum(float((level @ half).abs().sum()) for half in halves)
        if cost < best_cost - 1e-9:
            best, best_cost = turn, cost
    return torch.stack([
        math.cos(best) * first + math.sin(best) * second,
        math.cos(best) * second - math.sin(best) * first,
        third,
    ], dim=1)  # fmt: skip


def _half_axes(item: SceneObject) -> Float[Tensor, "3 3"]:
    """Half axes of an object's oriented box as columns."""
    turn = quat_to_matrix(torch.tensor(item.obb.quat_wxyz, dtype=torch.float64))
    return turn * torch.tensor(item.obb.size, dtype=torch.float64)[None] / 2
