"""The two protocols on test rooms: which rooms, which frames are shown, which are asked for."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from instok3d.data.batches import Unit, make_sample
from instok3d.data.sample import Sample
from instok3d.data.scenes import SceneSource
from instok3d.data.view_sampling import FrameChoice, eight_view_protocol, two_view_protocol

ProtocolName = Literal["rooms-2view", "rooms-8view"]

TEST_SEEDS = range(2_000_000, 2_000_100)
"""The rooms that every figure is measured on; no model may have seen them."""

LEVELS = ("easy", "medium", "hard")


@runtime_checkable
class RoomSource(SceneSource, Protocol):
    """Rooms: their names are seeds, and each has a level."""

    def level_of(self, number: int, /) -> str:
        """One of LEVELS."""
        ...


@dataclass(frozen=True)
class ProtocolScene:
    """One test scene with all that is asked of it."""

    name: str
    """In its data set; the seed of a room."""
    level: str | None
    """Under which name it is averaged apart, too: one of LEVELS for a room, its own name for a
    capture."""
    samples: tuple[Sample, ...]
    """Batches of one: different frames of the scene, predicted independently."""
    unit: Unit = "metre"
    """Of cameras and depths in the samples."""


def frame_choices(
    protocol: ProtocolName, num_frames: int, *, targets_per_scene: int = 3
) -> list[FrameChoice]:
    """The frames of every sample of a room.

    rooms-2view: contexts i-1 and i+1, target i, for `targets_per_scene` values of i in the
    middles of equal parts of the path: 3, 8, 12 of 16 frames by default. rooms-8view: one sample,
    contexts 0, 2, ..., 14 and targets 1, 3, ..., 13.

    Raises:
        ValueError: Fewer targets than 1 or more than frames with two neighbours, or a room with
            too few frames.
    """
    if protocol == "rooms-8view":
        return [eight_view_protocol(num_frames)]
    if not 1 <= targets_per_scene <= num_frames - 2:
        raise ValueError(
            f"targets_per_scene must be in 1..{num_frames - 2} for rooms of {num_frames} frames, "
            f"got {targets_per_scene}"
        )
    edges = np.linspace(1, num_frames - 2, 2 * targets_per_scene + 1)
    centers = np.floor(edges[1::2] + 0.5).astype(int)
    return [two_view_protocol(num_frames, center=int(center)) for center in centers]


def room_indices(
    seeds: Sequence[int], *, rejected: Collection[int] = (), num_scenes: int | None = None
) -> list[int]:
    """Where the test rooms stand in a data set, in the order of their seeds.

    Args:
        seeds: Seed of each room of the data set.
        rejected: Seeds that the generator found unusable; there is no room of them.
        num_scenes: The first so many alone; None for all.

    Raises:
        ValueError: num_scenes is below 1, or there are fewer usable rooms.
        FileNotFoundError: A test room was never made.
    """
    if num_scenes is not None and num_scenes < 1:
        raise ValueError(f"the number of scenes must be at least 1, got {num_scenes}")
    index_of = {seed: index for index, seed in enumerate(seeds)}
    found = []
    for seed in TEST_SEEDS:
        if len(found) == num_scenes:
            return found
        if seed in index_of:
            found.append(index_of[seed])
        elif seed not in rejected:
            raise FileNotFoundError(
                f"the data set has no room with seed {seed}; make the test rooms with: "
                f"instok3d data rooms -o DIR --seeds {TEST_SEEDS.start}:{TEST_SEEDS.stop}"
            )
    if num_scenes is not None and len(found) < num_scenes:
        raise ValueError(f"there are {len(found)} usable test rooms, got {num_scenes} to measure")
    return found


def protocol_rooms(
    source: RoomSource,
    indices: Sequence[int],
    protocol: ProtocolName,
    *,
    targets_per_scene: int = 3,
    model_unit: Unit | None = None,
) -> Iterator[ProtocolScene]:
    """The rooms one after the other, read when their turn comes.

    They are in metres, except for a model that answers in baselines.
    """
    unit = model_unit or "metre"
    for index in indices:
        num_frames = source.num_frames(index)
        choices = frame_choices(protocol, num_frames, targets_per_scene=targets_per_scene)
        yield ProtocolScene(
            name=source.name_of(index),
            level=source.level_of(index),
            samples=tuple(make_sample(source, index, choice, unit=unit) for choice in choices),
            unit=unit,
        )
