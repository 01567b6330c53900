"""The empty room: floor, ceiling, walls, door, windows with curtains."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from instok3d.rooms import colors
from instok3d.rooms.colors import Number
from instok3d.rooms.levels import Level
from instok3d.rooms.materials import Maker, Material
from instok3d.rooms.objects.base import fixed
from instok3d.rooms.objects.decor import curtain_of
from instok3d.rooms.plan import Box, Placed, Plan, Wall
from instok3d.rooms.primitives import Part, box, quad, rod
from instok3d.rooms.seeding import Streams

REVEAL_M = 0.14
"""How deep windows sit in the wall."""
SILL_M = 0.08
"""How far a window sill stands out into the room."""
CURTAIN_M = 0.13
"""Distance of a curtain's middle from the wall: clear of the sill."""


@dataclass(frozen=True)
class Opening:
    """A hole in a wall."""

    left: Number
    right: Number
    low: Number
    high: Number


def footprint_walls(
    width: Number, depth: Number, notch: tuple[int, float, float] | None
) -> list[Wall]:
    """Walls of a rectangle, clockwise from above; a notch (corner, width, depth) makes it an L."""
    corners = [(0.0, 0.0), (0.0, depth), (width, depth), (width, 0.0)]
    points: list[tuple[Number, Number]] = []
    for i, (x, y) in enumerate(corners):
        if notch is None or notch[0] != i:
            points.append((x, y))
            continue
        inner_x = notch[1] if x == 0 else width - notch[1]
        inner_y = notch[2] if y == 0 else depth - notch[2]
        cut = [(inner_x, y), (inner_x, inner_y), (x, inner_y)]
        points += cut if i in (0, 2) else cut[::-1]
    walls = []
    for start, end in zip(points, points[1:] + points[:1], strict=True):
        along = np.subtract(end, start)
        angle = float(np.arctan2(along[1], along[0]))
        walls.append(Wall(np.array(start), angle, float(np.hypot(*along))))
    return walls


def _wall_parts(wall: Wall, height: Number, holes: list[Opening], material: Material) -> list[Part]:
    """The wall's surface around its holes, and the holes' inner sides."""
    xs = sorted({0.0, wall.length} | {x for h in holes for x in (h.left, h.right)})
    zs = sorted({0.0, height} | {z for h in holes for z in (h.low, h.high)})
    parts = []
    for left, right in pairwise(xs):
        for low, high in pairwise(zs):
            inside = any(
                h.left <= left and right <= h.right and h.low <= low and high <= h.high
                for h in holes
            )
            if inside:
                continue
            cell = quad((left, 0, low), (right - left, 0, 0), (0, 0, high - low), material, False)
            parts.append(cell.mapped(cell.uvs + np.array([left, low])))
    for h in holes:
        across, up, inwards = (h.right - h.left, 0, 0), (0, 0, h.high - h.low), (0, REVEAL_M, 0)
        back = (0, -REVEAL_M, 0)
        parts += [
            quad((h.left, 0, h.low), inwards, up, material, False),
            quad((h.right, REVEAL_M, h.low), back, up, material, False),
            quad((h.left, 0, h.low), across, inwards, material, False),
            quad((h.left, 0, h.high), inwards, across, material, False),
        ]
    return parts


def _door_parts(make: Maker, frame: Material, width: Number, height: Number) -> list[Part]:
    """A closed door from x = 0, in the wall's frame."""
    if make.chance(0.4):
        leaf = frame
    elif make.chance(0.6):
        leaf = make.wood()
    else:
        color = colors.vivid(make.rng, (0.05, 0.6), (0.3, 0.95))
        leaf = make.plain("painted wood", color, gloss=0.1)
    metal, rim = make.metal(), 0.07
    parts = [box((width / 2, -0.01, height / 2), (width, 0.02, height), leaf)]
    for x in (-rim / 2, width + rim / 2):
        parts.append(box((x, -0.02, (height + rim) / 2), (rim, 0.04, height + rim), frame, 0.004))
    parts.append(box((width / 2, -0.02, height + rim / 2), (width, 0.04, rim), frame, 0.004))
    rows = make.integer(0, 4)
    for i in range(rows):
        for x in (width * 0.27, width * 0.73):
            panel = (width * 0.34, 0.012, height / rows * 0.72)
            parts.append(box((x, -0.024, height * (i + 0.5) / rows), panel, leaf, 0.006))
    right = make.chance(0.5)
    x = width * (0.9 if right else 0.1)
    end = x + (-0.11 if right else 0.11)
    parts.append(rod((x, -0.02, 1.0), (x, -0.07, 1.0), 0.01, metal))
    parts.append(rod((x, -0.065, 1.0), (end, -0.065, 1.0), 0.01, metal))
    return parts


def _window_parts(make: Maker, frame: Material, hole: Opening, daylight: Number) -> list[Part]:
    """Frame, panes, sill and the view outside, in the wall's frame."""
    view = make.window_view(daylight)
    width, height, bar, y = (
        hole.right - hole.left,
        hole.high - hole.low,
        make.uniform(0.04, 0.08),
        0.1,
    )
    middle, center = (hole.left + hole.right) / 2, (hole.low + hole.high) / 2
    parts = []
    for side in (-1, 1):
        x, z = middle + side * (width - bar) / 2, center + side * (height - bar) / 2
        parts.append(box((x, y, center), (bar, 0.05, height), frame))
        parts.append(box((middle, y, z), (width, 0.05, bar), frame))
    for x in {0: (), 1: (0.5,), 2: (1 / 3, 2 / 3)}[make.integer(0, 3)]:
        parts.append(box((hole.left + width * x, y, center), (bar * 0.7, 0.045, height), frame))
    if make.chance(0.4):
        z = hole.low + height * make.choice([0.5, 0.7])
        parts.append(box((middle, y, z), (width, 0.045, bar * 0.7), frame))
    corner = (hole.left, y + 0.015, hole.low)
    parts.append(quad(corner, (width, 0, 0), (0, 0, height), view))
    sill = (width + 0.06, SILL_M + REVEAL_M, 0.03)
    parts.append(box((middle, (REVEAL_M - SILL_M) / 2, hole.low - 0.014), sill, frame, 0.005))
    return parts


class Shell:
    """Builds the empty room into a plan."""

    def __init__(
        self,
        plan: Plan,
        streams: Streams,
        level: Level,
        room_type: str,
        maker: Callable[..., Maker],
    ):
        self.plan, self.streams, self.level, self.room_type = plan, streams, level, room_type
        self.maker = maker
        self.rng = streams.child("shell")
        self.holes: dict[int, list[Opening]] = {}

    def build(self) -> None:
        """Choose the openings, then make every surface an instance of its own."""
        plan, make = self.plan, self.maker("shell surfaces")
        self._footprint()
        door = self._choose_door()
        windows = self._choose_windows()
        width, depth, height = plan.width, plan.depth, plan.height
        floor = quad((0, 0, 0), (width, 0, 0), (0, depth, 0), make.floor(self.room_type), False)
        plan.add(Placed(fixed("floor", [floor]), "shell", 0, 0, 0, 0))
        ceiling = quad((0, 0, height), (0, depth, 0), (width, 0, 0), make.ceiling(), False)
        plan.add(Placed(fixed("ceiling", [ceiling]), "shell", 0, 0, 0, 0))
        common = self._walls(make, door)
        frame = make.white("painted wood") if make.chance(0.6) else make.wood()
        self._door(make, frame, door)
        self._windows(frame, windows)
        self._partition(common)

    def _footprint(self) -> None:
        plan, rng, notch = self.plan, self.rng, None
        if rng.random() < self.level.notch and min(plan.width, plan.depth) > 3.0:
            sizes = rng.uniform(0.25, 0.42, 2) * [plan.width, plan.depth]
            corner = int(rng.integers(4))
            notch = (corner, float(sizes[0]), float(sizes[1]))
            x = sizes[0] / 2 if corner in (0, 1) else plan.width - sizes[0] / 2
            y = sizes[1] / 2 if corner in (0, 3) else plan.depth - sizes[1] / 2
            plan.block(Box(float(x), float(y), notch[1], notch[2], 0.0, 0.0, plan.height))
        plan.walls = footprint_walls(plan.width, plan.depth, notch)
        self.notched = notch is not None

    def _choose_door(self) -> tuple[int, Opening]:
        rng, walls = self.rng, self.plan.walls
        width, height = float(rng.uniform(0.78, 0.95)), float(rng.uniform(1.95, 2.1))
        index = int(rng.choice([i for i, w in enumerate(walls) if w.length > width + 0.4]))
        left = float(rng.uniform(0.15, walls[index].length - width - 0.15))
        clear = walls[index].box(left + width / 2, width + 0.2, 0.75, 0.0, height + 0.1)
        self.plan.block(clear)
        return index, Opening(left, left + width, 0.0, height)

    def _choose_windows(self) -> list[tuple[int, Opening]]:
        rng, plan, found = self.rng, self.plan, []
        wanted = int(rng.choice([0, 1, 2], p=self.level.windows))
        if self.room_type == "bathroom":
            wanted = min(wanted, int(rng.random() < 0.6))
        for _ in range(wanted * 12):
            if len(found) == wanted:
                break
            index = int(rng.integers(len(plan.walls)))
            wall = plan.walls[index]
            if wall.length < 1.5:
                continue
            width = float(rng.uniform(0.7, min(2.0, wall.length - 0.7)))
            low = float(rng.uniform(0.75, 1.05)) if rng.random() < 0.85 else 0.1
            high = min(float(rng.uniform(1.9, 2.25)), plan.height - 0.15)
            left = float(rng.uniform(0.3, wall.length - width - 0.3))
            region = wall.box(
                left + width / 2, width + 0.12, SILL_M + 0.02, low - 0.05, high + 0.05
            )
            if not plan.fits(region):
                continue
            plan.block(region)
            hole = Opening(left, left + width, low, high)
            self.holes.setdefault(index, []).append(hole)
            found.append((index, hole))
        return found

    def _walls(self, make: Maker, door: tuple[int, Opening]) -> Material:
        common, accent = make.walls(self.room_type)
        accent_index = make.integer(0, len(self.plan.walls))
        board = make.white("painted wood") if make.chance(0.7) else make.wood()
        board_height = make.uniform(0.06, 0.12) if make.chance(0.85) else 0.0
        for i, wall in enumerate(self.plan.walls):
            material = accent if i == accent_index else common
            parts = _wall_parts(wall, self.plan.height, self.holes.get(i, []), material)
            spans = [(0.0, wall.length)]
            if i == door[0]:
                spans = [(0.0, door[1].left - 0.08), (door[1].right + 0.08, wall.length)]
            for left, right in spans:
                if board_height and right - left > 0.05:
                    middle = ((left + right) / 2, -0.0075, board_height / 2)
                    parts.append(box(middle, (right - left, 0.015, board_height), board))
            self._add(wall, "wall", parts)
        return common

    def _add(self, wall: Wall, name: str, parts: list[Part], along: Number = 0.0) -> None:
        x, y = wall.point(along, 0.0)
        self.plan.add(Placed(fixed(name, parts), "shell", float(x), float(y), 0.0, wall.angle_rad))

    def _door(self, make: Maker, frame: Material, door: tuple[int, Opening]) -> None:
        index, hole = door
        parts = _door_parts(make, frame, hole.right - hole.left, hole.high)
        self._add(self.plan.walls[index], "door", parts, hole.left)

    def _windows(self, frame: Material, windows: list[tuple[int, Opening]]) -> None:
        low, high = self.level.daylight
        day = float(self.rng.uniform(low, high))
        if self.rng.random() < self.level.night:
            day = float(self.rng.uniform(0.05, 0.4))
        for number, (index, hole) in enumerate(windows):
            make, wall = self.maker("window", number), self.plan.walls[index]
            self._add(wall, "window", _window_parts(make, frame, hole, day))
            if self.room_type != "bathroom" and self.rng.random() < 0.55:
                sides = ("left", "right") if self.rng.random() < 0.8 else ("left",)
                for side in sides:
                    self._curtain(wall, hole, side, number)

    def _curtain(self, wall: Wall, hole: Opening, side: str, number: int) -> None:
        """A curtain at one side of a window, the same cloth on both."""
        make = self.maker("curtain", number)
        width = min(make.uniform(0.3, 0.55), (hole.right - hole.left) * 0.45)
        top = min(hole.high + 0.12, self.plan.height - 0.06)
        bottom = 0.04 if make.chance(0.6) else max(hole.low - 0.1, 0.04)
        along = hole.left - 0.1 + width / 2 if side == "left" else hole.right + 0.1 - width / 2
        along = float(np.clip(along, width / 2 + 0.06, wall.length - width / 2 - 0.06))
        cloth = curtain_of(make, width, bottom, top)
        depth = CURTAIN_M + cloth.size[1] / 2
        region = wall.box(along, cloth.size[0], depth, bottom, top + 0.03)
        blocked = [b for b in self.plan.obstacles.values() if b.overlaps(region)]
        if len(blocked) > 1:  # one is the window that it belongs to
            return
        x, y = wall.point(along, -CURTAIN_M + cloth.size[1] / 2)
        z = bottom + cloth.size[2] / 2
        self.plan.add(Placed(cloth, "curtain", float(x), float(y), z, wall.angle_rad), region)

    def _partition(self, material: Material) -> None:
        """Sometimes a short wall that stands out into the room."""
        plan, rng = self.plan, self.rng
        if self.notched or rng.random() >= self.level.partition:
            return
        for _ in range(10):
            wall = plan.walls[int(rng.integers(len(plan.walls)))]
            length = float(rng.uniform(0.8, 1.5))
            along = float(rng.uniform(0.35, 0.65)) * wall.length
            region = wall.box(along, 0.12, length, 0.0, plan.height)
            if wall.length > 3.0 and plan.fits(region, gap=0.1):
                x, y = wall.point(along, 0.0)
                size = (0.12, length, plan.height)
                body = fixed("wall", [box((0, -length / 2, plan.height / 2), size, material)])
                placed = Placed(body, "partition", float(x), float(y), 0.0, wall.angle_rad)
                plan.add(placed, region)
                return
