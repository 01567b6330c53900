"""Label sets of the figures: the classes of the rooms, and the eight of LSM's evaluation.

"other" is no word that a text encoder could place. A pixel is therefore compared with the phrases
of all classes of the rooms, and what is nearest to none of LSM's seven is "other".
"""

from instok3d.datasets.scannet.labels import CLASSES as LSM_CLASSES
from instok3d.rooms.classes import CLASSES as ROOM_CLASSES
from instok3d.rooms.classes import NYU40

OTHER = LSM_CLASSES.index("other")

__all__ = ["LSM_CLASSES", "LSM_OF_ROOM", "OTHER", "PHRASES", "ROOM_CLASSES", "lsm_class"]


def lsm_class(label: str) -> int:
    """The place in LSM_CLASSES of a class of the rooms, by its NYU40 name; OTHER if it has none."""
    name = NYU40.get(label, label)
    return LSM_CLASSES.index(name) if name in LSM_CLASSES else OTHER


PHRASES = ROOM_CLASSES
"""The text that is embedded for each class of the rooms: its name."""

LSM_OF_ROOM = tuple(lsm_class(label) for label in ROOM_CLASSES)
"""The LSM class of each class of the rooms."""
