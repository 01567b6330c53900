"""How hard a room is: easy, medium, hard, or with the statistics of real photos."""

from dataclasses import dataclass

import numpy as np

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
    on_each: tuple[int, int] = (0, 5)
    """Things wanted on each piece of furniture, from and up to but not including."""
    windows: tuple[float, float, float] = (0.12, 0.58, 0.3)
    """Probabilities of no, one and two windows."""
    natural: bool = False
    """Materials, colours and lamps as in real homes (`NaturalMaker`)."""
    things_per_m2: tuple[float, float] = (0.0, 0.0)
    """Further things on each square metre of table tops, shelves and counters, by room."""
    wall_things: tuple[int, int] = (0, 1)
    """Notes, calendars, posters, hooks, wall cabinets: from and up to but not including."""
    floor_things: tuple[int, int] = (0, 1)
    """Shoes, bags, stacks, papers on the floor: from and up to but not including."""
    sockets: tuple[int, int] = (0, 1)
    """Sockets and switches tried for, many with cables: from and up to but not including."""
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
    sun: float = 0.0
    """Probability that the sun shines through the windows of a room in daylight."""
    ambient: tuple[float, float] = (1.0, 1.0)
    """Share of the light of many bounces; less makes corners darker."""
    window_visible: tuple[float, float] = (0.7, 2.0)
    """Most radiance that windows show to the camera."""
    lamp_visible: float = 2.2
    """Most radiance that a lamp shows to the camera; more makes edges more ragged."""
    exposure_stops: tuple[float, float] = (-0.9, 0.4)
    """Of the whole scene relative to automatic exposure."""
    mean_luma: tuple[float, float, float] | None = None
    """Least, commonest and largest mean luma of a scene, which then replaces exposure_stops."""
    contrast: tuple[float, float] = (0.0, 0.0)
    """Weight of a tone curve that darkens shadows and brightens lights."""
    white_balance: bool = False
    """The camera's white balance is that of one light of the room, or between two."""
    drift_stops: float = 0.0
    """Change of exposure from frame to frame along the path, up to this much from the mean."""
    fov_deg: tuple[float, float] = (60.0, 60.0)
    """Least and largest horizontal field of view."""
    fov_mode_deg: float | None = None
    """Commonest field of view, drawn on a logarithmic scale; None draws all alike."""
    height_m: tuple[float, float] = (1.2, 1.65)
    """Mean height of the camera along a path."""
    tilt: float = 1.0
    """Amplitude of roll and pitch relative to a steady hand."""
    near_m: float = 1.05
    """Least median distance of what a frame shows."""
    near_share: float = 0.12
    """Most of a frame that may lie within 0.55 m."""
    gloss: bool = False
    """Glossy materials reflect."""
    sensor: bool = False
    """Pictures go through blur, noise and JPEG."""

    def draw_fov_deg(self, rng: np.random.Generator) -> float:
        """A camera's horizontal field of view."""
        if self.fov_mode_deg is None:
            return float(rng.uniform(*self.fov_deg))
        low, high = np.log(self.fov_deg)
        return float(np.exp(rng.triangular(low, np.log(self.fov_mode_deg), high)))


LEVELS = {
    level.name: level
    for level in (
        Level("easy", (4, 7), 2, (0, 2), 0.25, True, on_each=(0, 3), windows=(0.02, 0.53, 0.45),
              daylight=(3.0, 7.0), night=0.05, exposure_stops=(-0.3, 0.4)),
        Level("medium", (6, 11), 6, (1, 4), 1.0, False),
        Level("hard", (9, 15), 14, (2, 7), 1.6, False, notch=0.3, partition=0.25,
              night=0.35, lamps=(0.35, 0.45, 0.2), unlit=0.3, exposure_stops=(-1.5, 0.5),
              drift_stops=0.35, fov_deg=(55.0, 70.0), gloss=True, sensor=True),
        Level("real", (9, 16), 12, (2, 6), 1.6, False, natural=True, things_per_m2=(8.0, 40.0),
              wall_things=(8, 22), floor_things=(3, 13), sockets=(4, 14), notch=0.3, partition=0.25,
              daylight=(1.5, 8.0), night=0.35, lamps=(0.4, 0.35, 0.25), unlit=0.3, sun=0.6,
              ambient=(0.4, 0.9), window_visible=(2.0, 12.0), lamp_visible=5.0,
              mean_luma=(0.2, 0.36, 0.56), contrast=(0.4, 1.0), white_balance=True,
              fov_deg=(40.0, 95.0), fov_mode_deg=66.0, height_m=(1.1, 1.75), tilt=1.7,
              near_m=0.8, near_share=0.2, gloss=True),
    )
}  # fmt: skip

LEVEL_MIX = {"easy": 0.3, "medium": 0.5, "hard": 0.2}
"""Share of each level where none was asked for."""

LEVEL_NAMES = ("mix", *LEVELS)
"""What may be asked for."""


def check_level(asked: str) -> None:
    """Raise ValueError where no such level exists."""
    if asked not in LEVEL_NAMES:
        names = ", ".join(LEVEL_NAMES[:-1])
        raise ValueError(f"level {asked!r} is unknown; choose {names} or {LEVEL_NAMES[-1]}")


def level_of(streams: Streams, asked: str = "mix") -> Level:
    """The level of a room: the one asked for, or drawn from LEVEL_MIX.

    Raises:
        ValueError: No such level.
    """
    check_level(asked)
    if asked == "mix":
        asked = str(streams.child("level").choice(list(LEVEL_MIX), p=list(LEVEL_MIX.values())))
    return LEVELS[asked]
