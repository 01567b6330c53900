"""What the things in a scene are called."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ObjectWords:
    """English words for one instance, in lower case; empty where nobody knows."""

    label: str
    """Its class, such as "coffee table"."""
    color: str = ""
    """The name of the colour that its pixels show."""
    material: str = ""
    """Of which most of its surface is made."""
    nyu40: str = ""
    """Its NYU40 class as the data set's own table has it; empty where that follows from label."""
