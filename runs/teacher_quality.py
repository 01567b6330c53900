"""Prints how often a teacher is right about photos of rooms, by class.

    python runs/teacher_quality.py ROOMS TEACHER [--scenes 100] [--frames 2 4 7 9 11 13]

ROOMS is a folder of rooms with words, TEACHER as behind --teacher (rooms:FILE, lseg:FILE, ...).
--held-out takes the last 5 % of the scenes alone, which training rooms are validated with. The
frames are those that the protocol rooms-2view shows (2, 4, 7, 9, 11, 13).
"""

import argparse
from pathlib import Path

from instok3d.evaluation.teachers import measure_teacher
from instok3d.rooms.dataset import RoomDataset
from instok3d.semantics.teachers import open_teacher
from instok3d.training.held_out import hold_out_last


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("rooms", type=Path)
    parser.add_argument("teacher")
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--frames", type=int, nargs="+", default=[2, 4, 7, 9, 11, 13])
    parser.add_argument("--held-out", action="store_true")
    given = parser.parse_args()
    rooms = RoomDataset(given.rooms)
    numbers = hold_out_last(len(rooms))[1] if given.held_out else range(len(rooms))
    scenes = (rooms.frames(number, given.frames) for number in numbers[: given.scenes])
    print(measure_teacher(open_teacher(given.teacher), scenes).table())


if __name__ == "__main__":
    main()
