"""The 87 generators of furniture and things; importing this fills the registry."""

from instok3d.rooms.objects import (
    appliances,
    bedbath,
    decor,
    electronics,
    floor_things,
    lamps,
    seating,
    small,
    storage,
    tables,
    tabletop,
    wall_things,
)
from instok3d.rooms.objects.base import HELD_OUT_GENERATORS, REGISTRY, Furniture, Support

__all__ = [
    "HELD_OUT_GENERATORS", "REGISTRY", "Furniture", "Support", "appliances", "bedbath", "decor",
    "electronics", "floor_things", "lamps", "seating", "small", "storage", "tables", "tabletop",
    "wall_things",
]  # fmt: skip
