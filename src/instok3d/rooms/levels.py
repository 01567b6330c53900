"""How hard a room is: easy, medium or hard."""

from dataclasses import dataclass

from instok3d.rooms.seeding import Streams


@dataclass(frozen=True)
class Level:
    """Everything in which the levels differ."""

    name: str
    majors: tuple[int, int]
    """Pieces of furniture wanted, from and up to but not including."""
    small: int
    """Most things on furniture."""
    wall_items: tuple[int, int]
    """Pictures, mirrors, clocks, shelves: from and up to but not including."""
    clutter: float
    """Weight of small things on the floor relative to furniture."""
    plain: bool
    """No patterned cloth, wallpaper or chequered floors."""
    notch: float = 0.0
    """Probability of an L-shaped room."""
    partition: float = 0.0
    """Probability of a short wall into a room that is not L-shaped."""
    daylight: tuple[float, float] = (2.0, 6.0)
    """Radiance of windows by day relative to lamps."""
    night: float = 0.2
    """Probability of dark windows."""
    lamps: tuple[float, float, float] = (0.6, 0.3, 0.1)
    """Probabilities of one, two and four ceiling lamps."""
    unlit: float = 0.0
    """Probability that the ceiling lamps are off in a room that has windows or other lamps."""
    exposure_stops: tuple[float, float] = (-0.9, 0.4)
    """Of the whole scene relative to automatic exposure."""
    drift_stops: float = 0.0
    """Change of exposure from frame to frame along the path, up to this much from the mean."""
    fov_deg: tuple[float, float] = (60.0, 60.0)
    gloss: bool = False
    """Glossy materials reflect."""
    sensor: bool = False
    """Pictures go through blur, noise and JPEG."""


LEVELS = {
    level.name: level
    for level in (
        Level("easy", (4, 7), 2, (0, 2), 0.25, True, daylight=(3.0, 7.0), night=0.05,
              exposure_stops=(-0.3, 0.4)),
        Level("medium", (6, 11), 6, (1, 4), 1.0, False),
        Level("hard", (9, 15), 14, (2, 7), 1.6, False, notch=0.3, partition=0.25,
              night=0.35, lamps=(0.35, 0.45, 0.2), unlit=0.3, exposure_stops=(-1.5, 0.5),
              drift_stops=0.35, fov_deg=(55.0, 70.0), gloss=True, sensor=True),
    )
}  # fmt: skip

LEVEL_MIX = {"easy": 0.3, "medium": 0.5, "hard": 0.2}
"""Share of each level where none was asked for."""


def level_of(streams: Streams, asked: str = "mix") -> Level:
    """The level of a room: the one asked for, or drawn from LEVEL_MIX.

    Raises:
        ValueError: No such level.
    """
    if asked == "mix":
        asked = str(streams.child("level").choice(list(LEVEL_MIX), p=list(LEVEL_MIX.values())))
    if asked not in LEVELS:
        raise ValueError(f"level {asked!r} is unknown; choose mix, easy, medium or hard")
    return LEVELS[asked]
