"""Filling the empty room: furniture, rugs, things on furniture, things on walls, lamps."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from instok3d.rooms.colors import Number
from instok3d.rooms.levels import Level
from instok3d.rooms.objects import HELD_OUT_GENERATORS
from instok3d.rooms.objects.base import Furniture, Support
from instok3d.rooms.pieces import Pieces
from instok3d.rooms.plan import Box, Placed, Plan, Wall
from instok3d.rooms.primitives import rot_z
from instok3d.rooms.seeding import Streams

Weights = Mapping[str, Number]

FIRST = {"living room": "sofa", "bedroom": "bed", "office": "desk", "kitchen": "counter",
         "bathroom": "toilet", "studio flat": "bed"}  # fmt: skip
"""What every room of a type has."""

AT_WALL: dict[str, Weights] = {
    "living room": {"sofa": 3, "tv_stand": 2.5, "bookshelf": 2, "cabinet": 2, "armchair": 2,
                    "piano": 1.5, "dresser": 0.7, "bench": 1, "radiator": 1, "side_table": 1},
    "bedroom": {"bed": 4, "wardrobe": 2, "dresser": 2, "nightstand": 1.5, "desk": 1.2,
                "bookshelf": 1, "armchair": 1, "bench": 1, "radiator": 1, "tv_stand": 0.6},
    "office": {"desk": 5, "bookshelf": 3, "cabinet": 2.5, "sofa": 0.7, "radiator": 1,
               "wardrobe": 0.5, "piano": 0.5},
    "kitchen": {"counter": 4, "refrigerator": 3, "oven": 2.5, "cabinet": 1.5,
                "washing_machine": 1.2, "wardrobe": 0.5, "bench": 0.8, "radiator": 0.5},
    "bathroom": {"toilet": 3, "sink": 5, "bathtub": 5, "washing_machine": 1.5, "cabinet": 1.2,
                 "shower_curtain": 3, "radiator": 0.8},
    "studio flat": {"bed": 2, "counter": 3, "refrigerator": 2, "sofa": 2, "wardrobe": 1,
                    "desk": 1.5, "bookshelf": 1, "sink": 1, "oven": 1, "piano": 1, "bench": 1},
}  # fmt: skip
"""Furniture that stands with its back to a wall."""

FREE: dict[str, Weights] = {
    "living room": {"coffee_table": 2, "armchair": 1.5, "ottoman": 1.5, "plant": 2,
                    "floor_lamp": 2, "chair": 1, "table": 1.2, "ball": 0.5, "box": 0.5,
                    "stool": 0.8, "suitcase": 0.3},
    "bedroom": {"plant": 1.2, "floor_lamp": 1.2, "chair": 1.5, "ottoman": 1, "suitcase": 1.5,
                "backpack": 1, "trash_can": 0.7, "ball": 0.6, "box": 0.8, "stool": 0.5},
    "office": {"table": 1.5, "chair": 3, "trash_can": 1.5, "plant": 1.2, "floor_lamp": 0.8,
               "box": 1.2, "backpack": 0.8, "stool": 0.5, "suitcase": 0.5},
    "kitchen": {"table": 4, "stool": 2, "trash_can": 1.2, "chair": 1.5, "plant": 0.8,
                "box": 0.6, "backpack": 0.4},
    "bathroom": {"stool": 1.5, "trash_can": 2, "plant": 1, "box": 0.7, "ball": 0.3},
    "studio flat": {"table": 2, "chair": 2, "coffee_table": 1, "plant": 1, "floor_lamp": 1,
                    "suitcase": 1, "box": 0.6, "backpack": 0.6, "ottoman": 1},
}  # fmt: skip
"""Furniture that stands anywhere."""

CLUTTER = ("ball", "box", "backpack", "trash_can", "suitcase", "stool")
"""Small things on the floor, whose weight depends on the level."""

UNIQUE = ("bed", "toilet", "bathtub", "sink", "refrigerator", "oven", "piano", "tv_stand",
          "shower_curtain", "washing_machine")  # fmt: skip
"""At most one of each in a room."""

_DECOR: Weights = {"vase": 2, "table_lamp": 3, "books": 2, "small_plant": 2, "bowl": 2, "cup": 1,
                   "bottle": 1, "box": 0.7, "telephone": 0.7}  # fmt: skip
_KITCHEN: Weights = {"microwave": 2.5, "toaster": 3, "bowl": 3, "bottle": 3, "cup": 2,
                     "small_plant": 1}  # fmt: skip
_TABLE: Weights = {"bowl": 3, "vase": 3, "bottle": 2, "cup": 2, "laptop": 1.5, "books": 1.5,
                   "small_plant": 2}  # fmt: skip

ON_TOP: dict[str, Weights] = {
    "desk": {"monitor": 3, "laptop": 3, "keyboard": 3.5, "table_lamp": 2.5, "books": 2.5,
             "small_plant": 1.5, "cup": 2, "printer": 2.5, "telephone": 2.5, "vase": 0.7},
    "counter": _KITCHEN, "washing machine": _KITCHEN, "table": _TABLE, "coffee table": _TABLE,
    "sofa": {"pillow": 1},
    "cabinet": {**_DECOR, "printer": 1.0},
}  # fmt: skip
"""What stands on furniture of a class; _DECOR on all others."""

ON_WALL: Weights = {"picture": 5, "mirror": 1, "clock": 1.2, "wall_shelf": 1.2, "whiteboard": 0.3}


class Furnisher:
    """Fills a plan; every object draws its shape from a stream of its own."""

    def __init__(
        self,
        plan: Plan,
        streams: Streams,
        level: Level,
        room_type: str,
        pieces: Pieces,
        held_out: bool,
    ):
        self.plan, self.level, self.room_type = plan, level, room_type
        self.streams, self.held_out = streams, held_out
        self._make = pieces.make

    def build(self) -> None:
        """Everything, from large to small."""
        self._furniture(self.streams.child("furniture"))
        self._rug(self.streams.child("rug"))
        self._ceiling_lamps(self.streams.child("ceiling lamps"))
        self._wall_items(self.streams.child("wall items"))
        self._small(self.streams.child("small things"))

    def _pick(self, rng: np.random.Generator, weights: Weights) -> str:
        """A generator's name; held-out ones never, or three times as often in transfer rooms."""
        names = [n for n in weights if self.held_out or n not in HELD_OUT_GENERATORS]
        odds = np.array([weights[n] * self._emphasis(n) for n in names], float)
        return str(rng.choice(names, p=odds / odds.sum()))

    def _emphasis(self, name: str) -> float:
        clutter = self.level.clutter if name in CLUTTER else 1.0
        return clutter * (3.0 if name in HELD_OUT_GENERATORS else 1.0)

    def _put(
        self, name: str, item: Furniture, x: float, y: float, angle: float, gap: float = 0.04
    ) -> bool:
        """Stand an object on the floor if it fits."""
        width, depth, height = item.size
        region = Box(x, y, width, depth, angle, 0.0, height)
        if not self.plan.fits(region, gap):
            return False
        self.plan.add(Placed(item, name, x, y, 0.0, angle), region)
        return True

    def _furniture(self, rng: np.random.Generator) -> None:
        target, start = int(rng.integers(*self.level.majors)), len(self.plan.placed)
        queue = [FIRST[self.room_type]]
        for _ in range(60):
            if len(self.plan.placed) - start >= target:
                return
            at_wall = bool(queue) or rng.random() < 0.55
            weights = (AT_WALL if at_wall else FREE)[self.room_type]
            name = queue.pop() if queue else self._pick(rng, weights)
            if name in UNIQUE and any(p.generator == name for p in self.plan.placed):
                continue
            item = self._make(name)
            if at_wall:
                found = self._against_wall(rng, name, item)
                if found is not None:
                    self._companions(rng, name, item, *found)
            else:
                self._anywhere(rng, name, item)

    def _against_wall(
        self, rng: np.random.Generator, name: str, item: Furniture
    ) -> tuple[Wall, float] | None:
        """Try places along the walls, a third of them in corners."""
        width, depth, _ = item.size
        for _ in range(14):
            wall = self.plan.walls[int(rng.integers(len(self.plan.walls)))]
            if width > wall.length - 0.1:
                continue
            left, right = width / 2 + 0.03, wall.length - width / 2 - 0.03
            along = float(rng.uniform(left, right))
            if rng.random() < 0.3:
                along = left if rng.random() < 0.5 else right
            x, y = wall.point(along, -(depth / 2 + rng.uniform(0.02, 0.06)))
            if self._put(name, item, float(x), float(y), wall.angle_rad):
                return wall, along
        return None

    def _companions(
        self, rng: np.random.Generator, name: str, item: Furniture, wall: Wall, along: float
    ) -> None:
        """A chair at the desk, a low table before the sofa, nightstands beside the bed."""
        depth = item.size[1] + 0.04
        if name == "desk" and rng.random() < 0.85:
            chair = self._make("chair")
            out = depth + chair.size[1] / 2 + rng.uniform(0.0, 0.15)
            x, y = wall.point(along + rng.uniform(-0.1, 0.1), -out)
            angle = wall.angle_rad + np.pi + rng.uniform(-0.4, 0.4)
            self._put("chair", chair, float(x), float(y), float(angle), gap=0.0)
        if name == "sofa" and rng.random() < 0.6:
            low = self._make("coffee_table")
            x, y = wall.point(along, -(depth + low.size[1] / 2 + rng.uniform(0.25, 0.5)))
            self._put("coffee_table", low, float(x), float(y), wall.angle_rad)
        if name == "bed" and rng.random() < 0.7:
            stand = self._make("nightstand")
            for side in (-1, 1):
                beside = along + side * (item.size[0] + stand.size[0] + 0.1) / 2
                x, y = wall.point(beside, -(stand.size[1] / 2 + 0.03))
                self._put("nightstand", stand, float(x), float(y), wall.angle_rad, gap=0.0)

    def _anywhere(self, rng: np.random.Generator, name: str, item: Furniture) -> None:
        plan = self.plan
        for _ in range(14):
            x, y = (
                float(rng.uniform(0.3, plan.width - 0.3)),
                float(rng.uniform(0.3, plan.depth - 0.3)),
            )
            angle = float(rng.integers(4) * np.pi / 2)
            if name != "table":
                angle += float(rng.uniform(-0.25, 0.25))
            if self._put(name, item, x, y, angle, gap=0.7 if name == "table" else 0.15):
                if name == "table" and rng.random() < 0.9:
                    self._chairs(rng, item, x, y, angle)
                return

    def _chairs(
        self, rng: np.random.Generator, table: Furniture, x: float, y: float, angle: float
    ) -> None:
        """Chairs of one kind around a table."""
        chair, (width, depth, _) = self._make("chair"), table.size
        ends = [(-1.0, 0), (1.0, 0)]
        sides = (
            [(0.0, s) for s in (-1, 1)]
            if width < 1.3
            else [(f, s) for s in (-1, 1) for f in (-0.28, 0.28)]
        )
        for fraction, side in sides + ends:
            if rng.random() < 0.3:
                continue
            pull = chair.size[1] / 2 + rng.uniform(0.0, 0.14)
            if side:
                local, turn = (
                    (fraction * width, side * (depth / 2 + pull)),
                    0.0 if side > 0 else np.pi,
                )
            else:
                local, turn = (fraction * (width / 2 + pull), 0.0), -fraction * np.pi / 2
            dx, dy = rot_z(angle)[:2, :2] @ np.array(local)
            facing = float(angle + turn + rng.uniform(-0.12, 0.12))
            self._put("chair", chair, float(x + dx), float(y + dy), facing, gap=0.0)

    def _rug(self, rng: np.random.Generator) -> None:
        plan = self.plan
        if rng.random() > 0.45 or self.room_type == "bathroom":
            return
        item = self._make("rug")
        # Furniture may stand on a rug; walls of the shell may not.
        furniture = [
            key
            for key in plan.obstacles
            if key > 0 and plan.placed[key - 1].generator != "partition"
        ]
        for _ in range(10):
            angle = float(rng.integers(2) * np.pi / 2)
            x, y = (
                float(rng.uniform(0.8, plan.width - 0.8)),
                float(rng.uniform(0.8, plan.depth - 0.8)),
            )
            width, depth, height = item.size
            if plan.fits(Box(x, y, width, depth, angle, 0.0, height), gap=0.1, ignore=furniture):
                plan.add(Placed(item, "rug", x, y, 0.0, angle))
                return

    def _ceiling_lamps(self, rng: np.random.Generator) -> None:
        plan = self.plan
        count = int(rng.choice([1, 2, 4], p=self.level.lamps))
        spots = {1: [(0.5, 0.5)], 2: [(0.3, 0.5), (0.7, 0.5)],
                 4: [(0.3, 0.3), (0.7, 0.3), (0.3, 0.7), (0.7, 0.7)]}[count]  # fmt: skip
        item = self._make("ceiling_lamp")
        width, depth, height = item.size
        for fx, fy in spots:
            for _ in range(6):
                x, y = plan.width * fx, plan.depth * fy
                region = Box(
                    x, y, width, depth, 0.0, plan.height - height - 1e-3, plan.height - 1e-3
                )
                if plan.fits(region):
                    lamp = Placed(item, "ceiling_lamp", x, y, plan.height - 1e-3, 0.0)
                    plan.add(lamp, region)
                    break
                fx, fy = (float(v) for v in rng.uniform(0.2, 0.8, 2))

    def _wall_items(self, rng: np.random.Generator) -> None:
        plan = self.plan
        weights = {**ON_WALL, "whiteboard": 2.5} if self.room_type == "office" else ON_WALL
        for _ in range(int(rng.integers(*self.level.wall_items))):
            name = self._pick(rng, weights)
            item = self._make(name)
            width, depth, height = item.size
            for _ in range(10):
                wall = plan.walls[int(rng.integers(len(plan.walls)))]
                if width > wall.length - 0.3:
                    continue
                along = float(rng.uniform(width / 2 + 0.12, wall.length - width / 2 - 0.12))
                z = float(rng.uniform(1.35, 1.75) if name != "clock" else rng.uniform(1.8, 2.1))
                low, high = z - height / 2, z + height / 2
                # Clear to 25 cm in front, so that no wardrobe hides it.
                clear = wall.box(along, width + 0.06, 0.25, low - 0.04, high + 0.04)
                if high > plan.height - 0.08 or not plan.fits(clear):
                    continue
                x, y = wall.point(along, -0.003)
                region = wall.box(along, width, depth + 0.003, low, high)
                plan.add(Placed(item, name, float(x), float(y), z, wall.angle_rad), region)
                break

    def _small(self, rng: np.random.Generator) -> None:
        """Things on top of furniture, up to the level's number."""
        hosts = [i for i, p in enumerate(self.plan.placed, 1) if p.furniture.supports]
        rng.shuffle(hosts)
        left = self.level.small
        for host in hosts:
            parent = self.plan.placed[host - 1]
            wanted = int(rng.integers(*self.level.on_each))
            if parent.generator == "tv_stand":
                wanted = max(wanted, 1)
            if parent.generator == "sofa":
                wanted = int(rng.integers(0, 3))
            for number in range(min(wanted, left)):
                name = self._small_name(rng, parent, number)
                thing = Placed(self._make(name), name, 0, 0, 0, 0, host)
                if put_on_top(self.plan, rng, thing, 0.0 if name == "television" else 0.3):
                    left -= 1

    def _small_name(self, rng: np.random.Generator, parent: Placed, number: int) -> str:
        if parent.generator == "tv_stand" and number == 0:
            return "television"
        if parent.generator == "desk" and number == 0 and rng.random() < 0.5:
            return "monitor"
        return self._pick(rng, ON_TOP.get(parent.furniture.name, _DECOR))


def put_on_top(plan: Plan, rng: np.random.Generator, thing: Placed, turn_rad: Number) -> bool:
    """Stand a thing on its parent, inside one of its supports, turned by up to turn_rad."""
    parent = plan.placed[thing.parent - 1]
    width, depth, height = thing.furniture.size
    supports = parent.furniture.supports
    support: Support = supports[int(rng.integers(len(supports)))]
    room_x, room_y = support.x1 - support.x0 - width, support.y1 - support.y0 - depth
    if room_x < -0.1 or room_y < -0.12:  # a little overhang is fine
        return False
    middle = (support.x0 + support.x1) / 2, (support.y0 + support.y1) / 2
    z = parent.z + support.z
    for _ in range(8):
        x = middle[0] + rng.uniform(-0.5, 0.5) * max(room_x, 0.0)
        y = middle[1] + rng.uniform(-0.5, 0.5) * max(room_y, 0.0)
        turn = float(rng.uniform(-turn_rad, turn_rad)) if turn_rad else 0.0
        dx, dy = rot_z(parent.angle_rad)[:2, :2] @ np.array([x, y])
        angle = parent.angle_rad + turn
        region = Box(float(parent.x + dx), float(parent.y + dy), width, depth, angle, z, z + height)
        if plan.fits(region, gap=0.01, ignore=(thing.parent,)):
            stood = replace(thing, x=region.x, y=region.y, z=z, angle_rad=angle)
            plan.add(stood, region)
            return True
    return False
