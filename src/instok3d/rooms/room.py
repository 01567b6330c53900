"""One room from one seed: its type, size, shell and furniture."""

from dataclasses import dataclass

import numpy as np

from instok3d.rooms.catalogues.opened import NO_CATALOGUES, Catalogues
from instok3d.rooms.everyday import EverydayThings
from instok3d.rooms.furnishing import Furnisher
from instok3d.rooms.levels import Level, level_of
from instok3d.rooms.materials import Maker, Style
from instok3d.rooms.mesh import Mesh, build_mesh
from instok3d.rooms.natural import NaturalMaker
from instok3d.rooms.pieces import Pieces
from instok3d.rooms.plan import Plan
from instok3d.rooms.seeding import Streams, split_of
from instok3d.rooms.shell import Shell

ROOM_TYPES = {
    "living room": 0.28,
    "bedroom": 0.24,
    "office": 0.2,
    "kitchen": 0.16,
    "bathroom": 0.12,
}
"""Share of each type."""

HELD_OUT_ROOM_TYPE = "studio flat"
"""Half of the transfer rooms, and no others."""

SIDE_M = {"living room": (3.4, 5.6), "bedroom": (3.0, 4.8), "office": (3.0, 5.2),
          "kitchen": (2.8, 4.6), "bathroom": (2.5, 3.6), "studio flat": (3.8, 5.6)}  # fmt: skip
"""Shortest and longest side of a room of each type."""


@dataclass(frozen=True)
class Room:
    """A furnished room before it is lit and seen."""

    seed: int
    level: Level
    room_type: str
    plan: Plan
    mesh: Mesh


def build_room(seed: int, level: str = "mix", catalogues: Catalogues = NO_CATALOGUES) -> Room:
    """The room of a seed. Seeds from 3,000,000 hold content that no other seed has.

    With catalogues some of its furniture and surfaces come from files; the others, the size of the
    room and its openings stay what they are without.

    Raises:
        ValueError: The seed or the level does not exist.
    """
    streams, held_out = Streams(seed), split_of(seed) == "transfer"
    chosen = level_of(streams, level)
    rng = streams.child("room")
    room_type = str(rng.choice(list(ROOM_TYPES), p=list(ROOM_TYPES.values())))
    if held_out and rng.random() < 0.5:
        room_type = HELD_OUT_ROOM_TYPE
    width, depth = (float(side) for side in rng.uniform(*SIDE_M[room_type], 2))
    plan = Plan(width, depth, float(rng.uniform(2.35, 3.0)))
    style = Style(chosen.plain, held_out, catalogues.textures)

    kit = NaturalMaker(streams.child("kit"), style).make_kit() if chosen.natural else None

    def maker(*key: str | int) -> Maker:
        stream = np.random.default_rng(streams.child(*key).integers(1 << 62))
        return NaturalMaker(stream, style, kit) if kit else Maker(stream, style)

    Shell(plan, streams, chosen, room_type, maker).build()
    models = catalogues.furniture
    objects, things = (Pieces(kind, maker, streams, models) for kind in ("object", "thing"))
    Furnisher(plan, streams, chosen, room_type, objects, held_out).build()
    EverydayThings(plan, streams, chosen, room_type, things, maker("wiring")).build()
    return Room(seed, chosen, room_type, plan, build_mesh(plan.placed))
