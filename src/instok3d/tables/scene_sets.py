"""The scenes that tables train on and measure: rooms of some folders, captures of real rooms.

Which rooms are for what follows from their seeds: training, test, transfer.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from instok3d.data.batches import Unit
from instok3d.evaluation.captures import (
    FRAMES_NEEDED,
    Capture,
    capture_scenes,
    find_captures,
    read_capture,
)
from instok3d.evaluation.outlines import OWN_OUTLINES, read_outlines
from instok3d.evaluation.protocols import TEST_SEEDS, ProtocolScene, protocol_rooms, room_indices
from instok3d.rooms.dataset import RoomDataset
from instok3d.rooms.materials import HELD_OUT_MATERIALS
from instok3d.rooms.objects.base import HELD_OUT_GENERATORS
from instok3d.rooms.room import HELD_OUT_ROOM_TYPE
from instok3d.rooms.seeding import split_seeds
from instok3d.rooms.shards import read_index
from instok3d.tables.data_sets import listed
from instok3d.tables.definitions import SceneKind, Views

TARGETS_PER_SCENE = 3
"""Of test rooms and captures with 2 context views."""


@runtime_checkable
class SceneSet(Protocol):
    """Scenes that rows are measured on."""

    @property
    def names(self) -> Sequence[str]:
        """Of the scenes, in the order in which they are measured."""
        ...

    def scene(self, number: int, views: Views, unit: Unit | None) -> ProtocolScene:
        """One of them, read when it is asked for, for a model that answers in this unit."""
        ...


@dataclass(frozen=True)
class RoomSet:
    """Some rooms of a folder."""

    dataset: RoomDataset
    indices: tuple[int, ...]
    targets_per_scene: int = TARGETS_PER_SCENE

    @property
    def names(self) -> Sequence[str]:
        """Their seeds."""
        return [self.dataset.name_of(index) for index in self.indices]

    def scene(self, number: int, views: Views, unit: Unit | None) -> ProtocolScene:
        """See `protocols.protocol_rooms`."""
        protocol = "rooms-2view" if views == 2 else "rooms-8view"
        return next(
            protocol_rooms(
                self.dataset, self.indices[number : number + 1], protocol,
                targets_per_scene=self.targets_per_scene, model_unit=unit,
            )
        )  # fmt: skip


@dataclass(frozen=True)
class CaptureSet:
    """Captures of real rooms, shown two photos."""

    captures: tuple[Capture, ...]
    targets_per_scene: int = TARGETS_PER_SCENE

    @property
    def names(self) -> Sequence[str]:
        """Of their folders."""
        return [capture.name for capture in self.captures]

    def scene(self, number: int, views: Views, unit: Unit | None) -> ProtocolScene:
        """See `captures.capture_scenes`."""
        found = capture_scenes(
            [self.captures[number]], "capture-2view" if views == 2 else "capture-8view",
            targets_per_scene=self.targets_per_scene, model_unit=unit, strict=True,
        )  # fmt: skip
        return next(iter(found))


def rooms_to_test(folders: Sequence[Path], num_scenes: int | None, targets: int) -> RoomSet:
    """The test rooms of the folder that has some.

    Raises:
        FileNotFoundError: No folder has, or some were never made.
        ValueError: There are fewer than were asked for.
    """
    for folder in folders:
        dataset = RoomDataset(folder, range(TEST_SEEDS.start, TEST_SEEDS.stop))
        if len(dataset):
            seeds = [dataset.seed_of(number) for number in range(len(dataset))]
            shards = read_index(folder)["shards"].values()
            rejected = {seed for shard in shards for seed in shard["rejected"]}
            indices = room_indices(seeds, rejected=rejected, num_scenes=num_scenes)
            return RoomSet(dataset, tuple(indices), targets)
    raise FileNotFoundError(
        f"no test room in {listed(folders)}; make them with: instok3d data rooms -o DIR --seeds "
        f"{TEST_SEEDS.start}:{TEST_SEEDS.stop}, and name that folder in --data too"
    )


def transfer_rooms(
    folders: Sequence[Path], kind: SceneKind, num_scenes: int | None, targets: int
) -> RoomSet:
    """Transfer rooms in which something is that no training room has.

    Args:
        folders: Of rooms; those of the transfer split are looked at.
        kind: What is held out.
        num_scenes: The first so many; None for all.
        targets: For each room.

    Raises:
        FileNotFoundError: There is no such room.
    """
    for folder in folders:
        dataset = RoomDataset(folder, split_seeds("transfer"))
        indices = [n for n in range(len(dataset)) if is_held_out(dataset.meta_of(n), kind)]
        if indices:
            return RoomSet(dataset, tuple(indices[:num_scenes]), targets)
    start = split_seeds("transfer").start
    raise FileNotFoundError(
        f"no transfer room with {kind} in {listed(folders)}; make some with: instok3d data rooms "
        f"-o DIR --seeds {start}:{start + 200}, and name that folder in --data too"
    )


def is_held_out(meta: Mapping[str, Any], kind: SceneKind) -> bool:
    """Whether frames of a room show something of this kind that no training room has."""
    if kind == "held-out room type":
        return meta["room_type"] == HELD_OUT_ROOM_TYPE
    seen = [thing for thing in meta["instances"] if sum(thing["pixels"]) > 0]
    if kind == "held-out furniture":
        return any(thing["generator"] in HELD_OUT_GENERATORS for thing in seen)
    return any(word in thing["material"] for thing in seen for word in HELD_OUT_MATERIALS)


def captures(folder: Path, side: int, views: Views, targets: int) -> CaptureSet:
    """The captures of a folder that have enough frames; every photo that is used was read once.

    Raises:
        FileNotFoundError: There is none.
        ValueError: One or a photo of it cannot be read, or none has enough frames.
    """
    known = read_outlines(OWN_OUTLINES)
    read = [read_capture(each, side=side, outlines=known) for each in find_captures(folder)]
    needed = FRAMES_NEEDED["capture-2view" if views == 2 else "capture-8view"]
    usable = tuple(each for each in read if each.num_frames(0) >= needed)
    if not usable:
        raise ValueError(f"no capture in {folder} has the {needed} frames that are needed")
    found = CaptureSet(usable, targets)
    for number in range(len(usable)):
        found.scene(number, views, None)  # a damaged photo ends the command before any training
    return found
