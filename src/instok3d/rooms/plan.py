"""Where things are: upright boxes, walls, and the plan that keeps them from overlapping."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from instok3d.rooms.colors import Number
from instok3d.rooms.objects.base import Furniture
from instok3d.rooms.primitives import rot_z


@dataclass(frozen=True)
class Box:
    """An upright box, turned about z."""

    x: Number
    y: Number
    width: Number
    depth: Number
    angle_rad: Number
    low: Number
    high: Number

    def grown(self, gap: Number) -> "Box":
        """The box with `gap` metres added to its width and to its depth."""
        return replace(self, width=self.width + gap, depth=self.depth + gap)

    @property
    def radius(self) -> float:
        """Of the circle through the corners."""
        return 0.5 * float((self.width**2 + self.depth**2) ** 0.5)

    def corners(self) -> Float[np.ndarray, "4 2"]:
        """The footprint, going round."""
        c, s = np.cos(self.angle_rad), np.sin(self.angle_rad)
        half = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [self.width / 2, self.depth / 2]
        return half @ np.array([[c, s], [-s, c]]) + [self.x, self.y]

    def distance(self, point: Float[np.ndarray, " 2"]) -> float:
        """Horizontal distance from a point to the footprint; negative inside."""
        c, s = np.cos(self.angle_rad), np.sin(self.angle_rad)
        dx, dy = point[0] - self.x, point[1] - self.y
        x = abs(dx * c + dy * s) - self.width / 2
        y = abs(dy * c - dx * s) - self.depth / 2
        return float(np.hypot(max(x, 0), max(y, 0)) if max(x, y) > 0 else max(x, y))

    def overlaps(self, other: "Box") -> bool:
        """Whether the boxes share volume (separating axes; touching is no overlap)."""
        if self.low >= other.high or other.low >= self.high:
            return False
        apart = (self.x - other.x) ** 2 + (self.y - other.y) ** 2
        if apart > (self.radius + other.radius) ** 2:  # not even their circumscribed circles meet
            return False
        mine, theirs = self.corners(), other.corners()
        for corners in (mine, theirs):
            for edge in (corners[1] - corners[0], corners[2] - corners[1]):
                normal = np.array([-edge[1], edge[0]])
                a, b = mine @ normal, theirs @ normal
                if a.max() <= b.min() + 1e-9 or b.max() <= a.min() + 1e-9:
                    return False
        return True


@dataclass(frozen=True)
class Wall:
    """A wall seen from inside: x runs to the right from its start, y outwards, z up."""

    start: Float[np.ndarray, " 2"]
    angle_rad: Number
    length: Number

    def point(self, along: Number, out: Number) -> Float[np.ndarray, " 2"]:
        """The floor point `along` the wall and `out` of the room (negative: inside)."""
        return self.start + rot_z(self.angle_rad)[:2, :2] @ np.array([along, out])

    def box(self, along: Number, width: Number, depth: Number, low: Number, high: Number) -> Box:
        """A box against the inside of the wall, centred at `along`."""
        x, y = self.point(along, -depth / 2)
        return Box(float(x), float(y), width, depth, self.angle_rad, low, high)


@dataclass(frozen=True)
class Placed:
    """An object in the room; its instance id is its place in the plan's list plus one."""

    furniture: Furniture
    generator: str
    x: Number
    y: Number
    z: Number
    angle_rad: Number
    parent: int = 0
    """Instance id of what it stands on; 0 = the floor, a wall or the ceiling."""


@dataclass
class Plan:
    """A room while it is being filled."""

    width: Number
    depth: Number
    height: Number
    walls: list[Wall] = field(default_factory=list)
    placed: list[Placed] = field(default_factory=list)
    obstacles: dict[int, Box] = field(default_factory=dict)
    """Box of every solid object by instance id; solid parts of the shell have negative keys."""

    def fits(self, box: Box, gap: Number = 0.0, ignore: Iterable[int] = ()) -> bool:
        """Whether a box lies inside the room and keeps `gap` / 2 from everything but `ignore`."""
        corners = box.corners()
        if corners.min() < -1e-6 or (corners > [self.width + 1e-6, self.depth + 1e-6]).any():
            return False
        if box.high > self.height + 1e-6:
            return False
        grown = box.grown(gap)
        skip = set(ignore)
        return not any(grown.overlaps(o) for key, o in self.obstacles.items() if key not in skip)

    def block(self, box: Box) -> None:
        """Keep a region free that belongs to no instance of its own."""
        self.obstacles[-1 - len(self.obstacles)] = box

    def add(self, placed: Placed, box: Box | None = None) -> int:
        """Put an object without a check; returns its instance id. No box: nothing solid."""
        self.placed.append(placed)
        if box is not None:
            self.obstacles[len(self.placed)] = box
        return len(self.placed)
