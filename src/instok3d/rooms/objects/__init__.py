"""The 58 furniture generators; importing this fills the registry."""

from instok3d.rooms.objects import (
    appliances,
    bedbath,
    decor,
    electronics,
    lamps,
    seating,
    small,
    storage,
    tables,
)
from instok3d.rooms.objects.base import HELD_OUT_GENERATORS, REGISTRY, Furniture, Support

__all__ = [
    "HELD_OUT_GENERATORS", "REGISTRY", "Furniture", "Support", "appliances", "bedbath", "decor",
    "electronics", "lamps", "seating", "small", "storage", "tables",
]  # fmt: skip
