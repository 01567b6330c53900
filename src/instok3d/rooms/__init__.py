"""Procedural rooms: an endless, seeded data set of furnished rooms with exact labels."""

from instok3d.rooms.classes import CLASSES, NYU40, SCANNET20, STUFF
from instok3d.rooms.dataset import RoomDataset, RoomScene

__all__ = ["CLASSES", "NYU40", "SCANNET20", "STUFF", "RoomDataset", "RoomScene"]
