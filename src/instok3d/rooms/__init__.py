"""Procedural rooms: an endless, seeded data set of furnished rooms with exact labels.

The public names are imported when they are first used: a reconstruction needs the table of classes
and not the generator.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from instok3d.rooms.classes import CLASSES, NYU40, SCANNET20, STUFF
    from instok3d.rooms.dataset import RoomDataset, RoomScene

__all__ = ["CLASSES", "NYU40", "SCANNET20", "STUFF", "RoomDataset", "RoomScene"]


def __dir__() -> list[str]:
    return sorted(__all__)


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'instok3d.rooms' has no attribute {name!r}")
    from importlib import import_module

    home = "dataset" if name.startswith("Room") else "classes"
    return getattr(import_module(f"instok3d.rooms.{home}"), name)
