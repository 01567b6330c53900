"""Reading a folder of rooms, also while it is being written."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from instok3d.data.scenes import SceneFrames
from instok3d.data.words import ObjectWords
from instok3d.rooms.catalogues.opened import credits_of
from instok3d.rooms.seen_colors import seen_colors
from instok3d.rooms.shards import Shard, read_index
from instok3d.rooms.words import with_seen_colors


@dataclass(frozen=True)
class RoomScene:
    """One scene: 16 frames of one room, in metres, OpenCV cameras, z of the world up."""

    images: UInt8[Tensor, "frame height width 3"]
    """sRGB bytes."""
    instances: Int[Tensor, "frame height width"]
    """Instance ids as in meta["instances"][i]["id"]; 0 = none."""
    depths_m: Float[Tensor, "frame height width"]
    """z-depth, to the millimetre."""
    world_from_cam: Float[Tensor, "frame 4 4"]
    intrinsics: Float[Tensor, "frame 3 3"]
    meta: dict[str, Any]
    """seed, level, room_type, and instances: id, class, color, material, size_m, parent, stuff,
    aabb_m, pixels (one count a frame)."""

    @property
    def seed(self) -> int:
        """What the scene was made from."""
        return self.meta["seed"]

    @property
    def level(self) -> str:
        """easy, medium or hard."""
        return self.meta["level"]


class RoomDataset:
    """The finished scenes of a folder, ordered by seed. Files are mapped, not loaded."""

    def __init__(self, folder: Path | str, seeds: range | None = None):
        """Keep the scenes whose seed is in `seeds`; None keeps all."""
        self.folder, self.seeds = Path(folder), seeds
        self._open: dict[str, Shard] = {}
        self._words: dict[int, Mapping[int, ObjectWords]] = {}
        self.refresh()

    def refresh(self) -> None:
        """Take up shards that were finished since the index was last read."""
        index = read_index(self.folder)
        self.resolution: int = index["resolution"]
        self._frames_per_scene: int = index["frames"]
        self.credits = credits_of(index.get("catalogues", {}))
        """Whose models and textures the pictures show, one line each."""
        found = [
            (seed, name, row, record["levels"][row])
            for name, record in index["shards"].items()
            for row, seed in enumerate(record["seeds"])
            if self.seeds is None or seed in self.seeds
        ]
        self._scenes = sorted(found)
        self._seeds = {name: record["seeds"] for name, record in index["shards"].items()}

    def __len__(self) -> int:
        return len(self._scenes)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_open": {}}  # open files do not go to other processes

    def seed_of(self, number: int) -> int:
        """The seed of scene `number`, without reading it."""
        return self._scenes[number][0]

    def level_of(self, number: int) -> str:
        """easy, medium or hard, without reading the scene."""
        return self._scenes[number][3]

    def name_of(self, number: int) -> str:
        """The seed as text."""
        return str(self.seed_of(number))

    def num_frames(self, number: int) -> int:
        """The same for all rooms of a folder."""
        return self._frames_per_scene

    def frames(self, number: int, chosen: Sequence[int]) -> SceneFrames:
        """These frames of scene `number`; the others are not read.

        Raises:
            IndexError: There is no such scene or frame.
            ValueError: Its file is missing or damaged.
        """
        if not all(0 <= frame < self._frames_per_scene for frame in chosen):
            raise IndexError(f"frames 0..{self._frames_per_scene - 1} exist, got {list(chosen)}")
        _, name, row, _ = self._scenes[number]
        shard = self._shard(name)
        return SceneFrames(
            name=self.name_of(number),
            images=shard.read_frames("images", row, chosen),
            instances=shard.read_frames("instances", row, chosen).to(torch.int64),
            depths_m=shard.read_frames("depths_mm", row, chosen).to(torch.float32) / 1000,
            world_from_cam=shard.read_frames("world_from_cam", row, chosen),
            intrinsics=shard.read_frames("intrinsics", row, chosen),
            words=self._words_of(shard, row),
        )

    def meta_of(self, number: int) -> Mapping[str, Any]:
        """What is known of scene `number` beside its frames; see `RoomScene.meta`."""
        _, name, row, _ = self._scenes[number]
        return self._shard(name).metas[row]

    def words_of(self, number: int) -> Mapping[int, ObjectWords]:
        """Words of the instances of scene `number`, with the colours that its frames show.

        They are found once; that reads all the frames of the scene.

        Raises:
            IndexError: There is no such scene.
            ValueError: Its file is missing or damaged.
        """
        _, name, row, _ = self._scenes[number]
        return self._words_of(self._shard(name), row)

    def scene(self, number: int) -> RoomScene:
        """Scene `number`; one copy out of the mapped file.

        Raises:
            IndexError: There is no such scene.
            ValueError: Its file is missing or damaged.
        """
        _, name, row, _ = self._scenes[number]
        shard = self._shard(name)
        return RoomScene(
            shard.read("images", row),
            shard.read("instances", row).to(torch.int64),
            shard.read("depths_mm", row).to(torch.float32) / 1000,
            shard.read("world_from_cam", row),
            shard.read("intrinsics", row),
            shard.metas[row],
        )

    def _words_of(self, shard: Shard, row: int) -> Mapping[int, ObjectWords]:
        seed = shard.metas[row]["seed"]
        if seed not in self._words:
            colors: dict[int, str] = {}
            if shard.words[row]:
                images, ids = shard.read("images", row), shard.read("instances", row)
                colors = seen_colors(images.numpy(), ids.to(torch.int64).numpy())
            self._words[seed] = with_seen_colors(shard.words[row], colors)
        return self._words[seed]

    def _shard(self, name: str) -> Shard:
        """An open shard; it stays open, a few hundred at most do."""
        if name not in self._open:
            seeds = self._seeds[name]
            self._open[name] = Shard(
                self.folder / name, seeds, self._frames_per_scene, self.resolution
            )
        return self._open[name]
