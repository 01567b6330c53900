"""The things of everyday life in a furnished room: on furniture, on walls, on the floor."""

import numpy as np

from instok3d.rooms.colors import Number
from instok3d.rooms.furnishing import Weights, put_on_top
from instok3d.rooms.levels import Level
from instok3d.rooms.materials import Maker
from instok3d.rooms.objects import Furniture
from instok3d.rooms.pieces import Pieces
from instok3d.rooms.plan import Box, Placed, Plan, Wall
from instok3d.rooms.seeding import Streams
from instok3d.rooms.wiring import wire

_HOME: Weights = {"magazines": 2, "papers": 1.5, "book_stack": 2, "standing_books": 2, "jar": 1,
                  "glass": 2, "cup": 1.5, "package": 1.5, "picture_stand": 2, "basket": 1.5,
                  "small_plant": 1, "vase": 1, "bottle": 1, "coiled_cable": 1,
                  "folded_towels": 0.7, "cloth": 0.7, "pen_holder": 0.7}  # fmt: skip
_KITCHEN: Weights = {"package": 4, "packages": 3, "jar": 4, "bottle": 3, "glass": 3, "cup": 2,
                     "plates": 3, "bowl": 1.5, "pen_holder": 2.5, "cloth": 1.5, "basket": 1.5,
                     "papers": 1, "magazines": 0.7, "toaster": 0.6, "picture_stand": 1}  # fmt: skip
_WORK: Weights = {"papers": 6, "magazines": 3, "book_stack": 3, "standing_books": 2.5, "cup": 2,
                  "glass": 1.5, "pen_holder": 2.5, "package": 1.5, "basket": 1.5, "keyboard": 1.5,
                  "laptop": 1, "coiled_cable": 2.5, "picture_stand": 1.2, "jar": 0.7,
                  "small_plant": 0.7, "table_lamp": 0.6, "box": 0.5}  # fmt: skip
_BATH: Weights = {"jar": 5, "folded_towels": 3, "glass": 2, "cloth": 2, "basket": 2, "package": 2,
                  "small_plant": 0.7, "bottle": 2}  # fmt: skip

ON_FURNITURE: dict[str, Weights] = {
    "desk": _WORK, "counter": _KITCHEN, "table": {**_HOME, **_KITCHEN, "papers": 3},
}  # fmt: skip
"""By the class of the furniture; by the type of the room on all others."""

IN_ROOM: dict[str, Weights] = {"office": _WORK, "kitchen": _KITCHEN, "bathroom": _BATH}

ON_WALLS: dict[str, Weights] = {
    "office": {"notes": 5, "pinboard": 3, "poster": 3, "wall_cabinet": 2, "wall_shelf": 3,
               "hung_clothes": 1, "hung_bag": 1},
    "kitchen": {"wall_cabinet": 6, "tool_rail": 3, "notes": 3, "hung_towel": 2, "wall_shelf": 3,
                "poster": 2, "hung_bag": 0.7},
    "bathroom": {"hung_towel": 5, "wall_cabinet": 2, "wall_shelf": 2, "notes": 0.7},
}  # fmt: skip
_HOME_WALLS: Weights = {"poster": 4, "notes": 2, "wall_shelf": 3, "hung_clothes": 2,
                        "hung_bag": 1.5, "picture": 3, "wall_cabinet": 1,
                        "pinboard": 1}  # fmt: skip

ON_FLOOR: Weights = {"shoes": 4, "carrier_bag": 3, "box_pile": 2, "crate": 2, "floor_papers": 1,
                     "cloth": 2, "backpack": 2, "broom": 1, "book_stack": 1.5, "package": 1,
                     "basket": 1, "box": 1}  # fmt: skip


class EverydayThings:
    """Adds to a plan what a level asks for beyond furniture."""

    def __init__(
        self,
        plan: Plan,
        streams: Streams,
        level: Level,
        room_type: str,
        pieces: Pieces,
        wiring: Maker,
    ):
        self.plan, self.level, self.room_type = plan, level, room_type
        self.streams, self._make, self._wiring = streams, pieces.make, wiring

    def build(self) -> None:
        """Sockets and cables, then things on walls, on the floor, and on furniture."""
        sockets = int(self.streams.child("sockets").integers(*self.level.sockets))
        if sockets:
            wire(self.plan, self._wiring, sockets)
        self._on_walls(self.streams.child("things on walls"))
        self._on_floor(self.streams.child("things on the floor"))
        self._on_furniture(self.streams.child("things on furniture"))

    def _draw(self, rng: np.random.Generator, weights: Weights) -> tuple[str, Furniture]:
        odds = np.array(list(weights.values()), float)
        name = str(rng.choice(list(weights), p=odds / odds.sum()))
        return name, self._make(name)

    def _on_furniture(self, rng: np.random.Generator) -> None:
        """As many things as the area of each support asks for, as far as they fit."""
        density = float(rng.uniform(*self.level.things_per_m2))
        hosts = [i for i, p in enumerate(self.plan.placed, 1) if p.furniture.supports]
        for host in hosts:
            parent = self.plan.placed[host - 1]
            if parent.generator in ("sofa", "box"):
                continue
            area = sum((s.x1 - s.x0) * (s.y1 - s.y0) for s in parent.furniture.supports)
            by_room = IN_ROOM.get(self.room_type, _HOME)
            weights = ON_FURNITURE.get(parent.furniture.name, by_room)
            for _ in range(rng.poisson(area * density)):
                name, item = self._draw(rng, weights)
                put_on_top(self.plan, rng, Placed(item, name, 0, 0, 0, 0, host), turn_rad=0.6)

    def _on_walls(self, rng: np.random.Generator) -> None:
        weights = ON_WALLS.get(self.room_type, _HOME_WALLS)
        for _ in range(int(rng.integers(*self.level.wall_things))):
            name, item = self._draw(rng, weights)
            for _ in range(12):
                wall = self.plan.walls[int(rng.integers(len(self.plan.walls)))]
                if item.size[0] < wall.length - 0.3 and self._hang(rng, name, item, wall):
                    break

    def _hang(self, rng: np.random.Generator, name: str, item: Furniture, wall: Wall) -> bool:
        """Hang a thing somewhere on a wall where nothing is in front of it."""
        width, depth, height = item.size
        along = float(rng.uniform(width / 2 + 0.1, wall.length - width / 2 - 0.1))
        low = float(rng.uniform(0.8, 1.5)) if depth < 0.2 else float(rng.uniform(1.3, 1.55))
        clear = wall.box(along, width + 0.03, depth + 0.02, low - 0.02, low + height + 0.02)
        if not self.plan.fits(clear):
            return False
        region = wall.box(along, width, depth + 0.003, low, low + height)
        x, y = wall.point(along, -0.003)
        placed = Placed(item, name, float(x), float(y), low + height / 2, wall.angle_rad)
        self.plan.add(placed, region)
        return True

    def _on_floor(self, rng: np.random.Generator) -> None:
        """Half of them along the walls and furniture, half anywhere; low ones go under tables."""
        plan = self.plan
        for _ in range(int(rng.integers(*self.level.floor_things))):
            name, item = self._draw(rng, ON_FLOOR)
            width, depth, height = item.size
            for _ in range(12):
                x, y, angle = self._floor_spot(rng, depth)
                region = Box(x, y, width, depth, angle, 0.0, height)
                if plan.fits(region, gap=0.02):
                    plan.add(Placed(item, name, x, y, 0.0, angle), region)
                    break

    def _floor_spot(self, rng: np.random.Generator, depth: Number) -> tuple[float, float, float]:
        plan = self.plan
        if rng.random() < 0.6:
            wall = plan.walls[int(rng.integers(len(plan.walls)))]
            out = depth / 2 + rng.uniform(0.03, 0.2)
            x, y = wall.point(float(rng.uniform(0.15, wall.length - 0.15)), -out)
            return float(x), float(y), float(wall.angle_rad + rng.normal(0, 0.2))
        x, y = rng.uniform([0.3, 0.3], [plan.width - 0.3, plan.depth - 0.3])
        return float(x), float(y), float(rng.uniform(0, 2 * np.pi))
