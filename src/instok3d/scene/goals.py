"""Where a robot could stand beside an object: a free spot on the floor, facing it, by boxes alone.

What no photo shows is taken to be free, and so is everything outside of boxes: a goal is a proposal
for a planner with sensors of its own, not a promise.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy import ndimage

from instok3d.geometry.cameras import invert_rigid
from instok3d.geometry.moving import Point
from instok3d.scene.objects import SceneObject
from instok3d.scene.said_relations import surrounding
from instok3d.scene.upright_boxes import level_axes, upright_boxes
from instok3d.semantics.query.relations import UprightBoxes

if TYPE_CHECKING:
    from instok3d.scene.scene import Scene

RADIUS_M = 0.25
"""Of a robot in a scene in metres."""
RADIUS_SHARE = 0.05
"""Of the room's longer level side, where the scene's unit is unknown."""
CELLS = 400
"""Of the map along the longer side of the room, at most."""
STEP, HEIGHT = 0.3, 6.0
"""In radii: lower things are driven over, and a robot passes under what is higher."""
REACH = 4.0
"""Farthest gap between robot and object, in radii."""


@dataclass(frozen=True)
class Goal:
    """A spot to stand on, in the scene's world and units."""

    position: Point
    """On the floor."""
    facing: Point
    """Level direction towards the object, unit length."""
    gap: float
    """Between the robot's rim and the object's box, seen from above."""
    radius: float
    """Of the robot that fits there."""


@dataclass(frozen=True)
class _Map:
    """Cells of the floor, in level coordinates along the walls."""

    low: Float[np.ndarray, " 2"]
    cell: float
    free: Bool[np.ndarray, "row column"]
    """Where a robot's middle can be; rows along the first axis."""

    def centers(self) -> Float[np.ndarray, "row column 2"]:
        rows, columns = (np.arange(count) + 0.5 for count in self.free.shape)
        grid = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)
        return self.low + self.cell * grid


def find_goal(scene: "Scene", item: SceneObject, radius: float | None = None) -> Goal:
    """The free spot nearest to an object that can be reached, and the direction to face it.

    Reached from where most of the photos were taken, or from the largest free part of the floor in
    a scene without photos. The room is as large as the boxes of all objects together.

    Args:
        scene: With its up; hidden objects are no obstacles.
        item: An object of it that is not hidden.
        radius: Of the robot, scene units. None takes RADIUS_M in scenes in metres, else
            RADIUS_SHARE of the room.

    Raises:
        ValueError: The object is hidden, the radius cannot be, or no spot is free within reach.
    """
    if item.hidden:
        raise ValueError(f"{item.key} is hidden: show it first, or choose another object")
    drawn = [each for each in scene.objects if not each.hidden]
    boxes, axes = upright_boxes(scene, drawn), level_axes(drawn, scene.vertical.up)
    row = [each.id for each in drawn].index(item.id)
    low, high = boxes.low[:, :2].amin(dim=0).double(), boxes.high[:, :2].amax(dim=0).double()
    longest = float((high - low).max())
    if radius is None:
        radius = RADIUS_M if scene.units == "metres" else RADIUS_SHARE * longest
    if not 0 < radius <= longest / 2 or radius < longest / CELLS:
        raise ValueError(
            f"radius must be from {longest / CELLS:.3g} to {longest / 2:.3g}, in units of a scene "
            f"that is {longest:.3g} long, got {radius:g}"
        )
    floor = _floor(boxes)
    obstacles = _obstacles(boxes, floor, radius)
    room = _map(boxes, obstacles, radius, low.numpy(), high.numpy())
    places = _photographers(scene, axes)
    spot, gap = _nearest(room, boxes, obstacles, row, radius, places)
    if spot is None:
        raise ValueError(
            f"no free spot for a robot of radius {radius:.3g} is within {REACH * radius:.3g} of "
            f"{item.key}: give a smaller radius, or another object"
        )
    return _goal(spot, gap, boxes, row, floor, axes, radius)


def _floor(boxes: UprightBoxes) -> float:
    """Height of the floor: the top of what is low and reaches around most things, or the lowest."""
    flat = boxes.size[:, 2] < 0.4 * boxes.size[:, :2].amax(dim=1)
    lowest = boxes.low[:, 2] <= boxes.center[:, 2].median()
    floors = (surrounding(boxes) & flat & lowest).nonzero()[:, 0].tolist()
    if floors:
        return min(float(boxes.high[each, 2]) for each in floors)
    return float(boxes.low[:, 2].min())


def _obstacles(boxes: UprightBoxes, floor: float, radius: float) -> list[int]:
    """Rows of what a robot can neither drive over nor pass under."""
    stands = boxes.high[:, 2] > floor + STEP * radius
    stands &= boxes.low[:, 2] < floor + HEIGHT * radius
    return (stands & ~surrounding(boxes)).nonzero()[:, 0].tolist()


def _map(
    boxes: UprightBoxes, obstacles: list[int], radius: float, low: np.ndarray, high: np.ndarray
) -> _Map:
    cell = max(radius / 3, float((high - low).max()) / CELLS)
    shape = tuple(int(count) for count in np.maximum(np.ceil((high - low) / cell), 1))
    room = _Map(low, cell, np.ones(shape, dtype=bool))
    centers = room.centers()
    free = np.ones(shape, dtype=bool)
    # A robot does not stand on the rim of the room, where walls are.
    free &= ((centers >= low + radius) & (centers <= high - radius)).all(axis=-1)
    for each in obstacles:
        free &= _distance(centers, boxes, each) >= radius
    return _Map(low, cell, free)


def _distance(
    centers: Float[np.ndarray, "*any 2"], boxes: UprightBoxes, row: int
) -> Float[np.ndarray, "*any"]:
    """From level points to a box, seen from above."""
    return np.linalg.norm(_aside(centers, boxes, row), axis=-1)


def _aside(
    centers: Float[np.ndarray, "*any 2"], boxes: UprightBoxes, row: int
) -> Float[np.ndarray, "*any 2"]:
    """How far level points lie beside a box, along each axis."""
    low, high = boxes.low[row, :2].double().numpy(), boxes.high[row, :2].double().numpy()
    return np.maximum(np.maximum(low - centers, centers - high), 0)


def _photographers(scene: "Scene", axes: Float[torch.Tensor, "3 3"]) -> Float[np.ndarray, "view 2"]:
    """Where the photos were taken, level coordinates."""
    eyes = invert_rigid(scene.cameras.cam_from_world)[:, :3, 3].double()
    return (eyes @ axes)[:, :2].numpy()


def _nearest(
    room: _Map,
    boxes: UprightBoxes,
    obstacles: list[int],
    row: int,
    radius: float,
    places: Float[np.ndarray, "view 2"],
) -> tuple[np.ndarray | None, float]:
    """The free cell that is nearest to the object, straight before it rather than at its corner."""
    if not room.free.any():
        return None, math.inf
    parts = np.zeros(room.free.shape, dtype=np.int32)
    ndimage.label(room.free, output=parts)
    sizes = np.bincount(parts.ravel())[1:]
    cells = np.floor((places - room.low) / room.cell).astype(int)
    inside = ((cells >= 0) & (cells < room.free.shape)).all(axis=1)
    votes = parts[tuple(cells[inside].T)]
    votes = votes[votes > 0]
    own = int(np.bincount(votes).argmax()) if len(votes) else int(sizes.argmax()) + 1
    centers = room.centers()[(parts == own) & room.free]
    gap = _distance(centers, boxes, row) - radius
    centers, gap = centers[gap <= REACH * radius], gap[gap <= REACH * radius]
    middle = boxes.center[row, :2].double().numpy()
    aside = _aside(centers, boxes, row).min(axis=-1)
    cost = gap + aside + 0.2 * np.linalg.norm(centers - middle, axis=-1)
    for each in cost.argsort(kind="stable"):
        if _is_open(centers[each], boxes, obstacles, row):
            return centers[each], max(0.0, float(gap[each]))
    return None, math.inf


def _is_open(
    spot: Float[np.ndarray, " 2"], boxes: UprightBoxes, obstacles: list[int], row: int
) -> bool:
    """Whether nothing stands between a spot and the object, but for what it stands on or in."""
    low, high = boxes.low[row, :2].double().numpy(), boxes.high[row, :2].double().numpy()
    way = spot + np.linspace(0, 1, 24)[:, None] * (np.clip(spot, low, high) - spot)
    between = [each for each in obstacles
               if each != row and _distance((low + high) / 2, boxes, each) > 0]  # fmt: skip
    return all((_distance(way[:-1], boxes, each) > 0).all() for each in between)


def _goal(
    spot: np.ndarray, gap: float, boxes: UprightBoxes, row: int, floor: float,
    axes: Float[torch.Tensor, "3 3"], radius: float,
) -> Goal:  # fmt: skip
    level = torch.tensor([*spot.tolist(), floor], dtype=torch.float64)
    low, high = boxes.low[row, :2].double(), boxes.high[row, :2].double()
    towards = torch.minimum(torch.maximum(level[:2], low), high) - level[:2]
    if not float(towards.norm()) > 0:  # right above or below it
        towards = boxes.center[row, :2].double() - level[:2]
    towards = towards / towards.norm().clamp_min(1e-12)
    x, y, z = (axes @ level).tolist()
    i, j, k = (axes[:, :2] @ towards).tolist()
    return Goal((x, y, z), (i, j, k), gap, radius)
