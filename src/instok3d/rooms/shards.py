"""Shards: 16 seeds of scenes in one safetensors file, and the index rooms.json beside them."""

import json
import re
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import safe_open
from torch import Tensor

from instok3d.files import write_json, write_safetensors
from instok3d.geometry.checks import check_intrinsics, rigid_fault
from instok3d.reading import naming_damage, one_of, parse_json, read_json, whole_number
from instok3d.rooms.camera_path import FRAMES
from instok3d.rooms.catalogues.opened import check_record
from instok3d.rooms.levels import LEVELS
from instok3d.rooms.scene import RenderedScene
from instok3d.rooms.seeding import GENERATOR_VERSION
from instok3d.rooms.words import stored_words

FORMAT = "instok3d-rooms-1"
REMEDY = "delete it and make the rooms again"
SHARD_REMEDY = "delete it and run `instok3d data rooms` on its seeds again"
MAX_FRAMES, MAX_RESOLUTION = 10_000, 16_384
"""Numbers beyond these are taken for damage."""
SHARD_SEEDS = 16
"""Seeds of a shard: number s holds seeds 16 s to 16 s + 15."""
INDEX = "rooms.json"


def shard_name(shard: int) -> str:
    """File name of a shard."""
    return f"rooms-{shard * SHARD_SEEDS:07d}.safetensors"


@dataclass(frozen=True)
class ShardRecord:
    """What the index says of a finished shard."""

    seeds: list[int]
    """Usable scenes, in the order in which they lie in the file."""
    rejected: list[int]
    """Seeds without a camera path."""
    levels: list[str]
    """Level of each usable scene."""


def write_shard(path: Path, scenes: list[RenderedScene]) -> None:
    """Write scenes of one resolution as a shard, atomically. No scenes make an empty file."""
    tensors: dict[str, torch.Tensor] = {}
    if scenes:
        for name in ("images", "instances", "depths_mm", "world_from_cam", "intrinsics"):
            tensors[name] = torch.from_numpy(np.stack([getattr(scene, name) for scene in scenes]))
    metadata = {"format": FORMAT, "scenes": json.dumps([scene.meta for scene in scenes])}
    write_safetensors(path, tensors, metadata)


def new_index(
    resolution: int, level: str, catalogues: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The index of a folder without shards; it names catalogues where rooms are made with some."""
    used = {"catalogues": dict(catalogues)} if catalogues else {}
    return {
        "format": FORMAT, "generator_version": GENERATOR_VERSION, "frames": FRAMES,
        "resolution": resolution, "level": level, **used, "shards": {},
    }  # fmt: skip


def read_index(folder: Path) -> dict[str, Any]:
    """The index of a folder of rooms.

    Raises:
        FileNotFoundError: The folder has no index.
        ValueError: The index is damaged, or not one of this format.
    """
    path = folder / INDEX
    if not path.is_file():
        raise FileNotFoundError(
            f"no {INDEX} in {folder}; make rooms with `instok3d data rooms -o {folder}`"
        )
    index = read_json(path, REMEDY)
    if not isinstance(index, dict) or index.get("format") != FORMAT:
        raise ValueError(f"{path} is not an index of rooms: its format is not {FORMAT!r}")
    missing = [key for key in new_index(0, "") if key not in index]
    if missing:
        raise ValueError(f"{path} is damaged: {', '.join(missing)} missing; {REMEDY}")
    with naming_damage(path, REMEDY):
        whole_number(index["frames"], 1, MAX_FRAMES)
        whole_number(index["resolution"], 1, MAX_RESOLUTION)
        _check_records(index["shards"])
        check_record(index.get("catalogues", {}))
    return index


def _check_records(shards: dict[str, dict[str, list]]) -> None:
    known: set[int] = set()
    for name, record in shards.items():
        if not re.fullmatch(r"rooms-\d{7,}\.safetensors", name):
            raise ValueError(f"{reprlib.repr(name)} is no name of a shard")
        seeds = [whole_number(seed) for seed in (*record["seeds"], *record["rejected"])]
        if len(set(seeds)) < len(seeds) or known & set(seeds):
            raise ValueError(f"{name} has seeds that stand twice")
        known |= set(seeds)
        if len(record["levels"]) != len(record["seeds"]):
            raise ValueError(f"{name} has not one level for each seed")
        for level in record["levels"]:
            one_of(level, tuple(LEVELS))


class Shard:
    """A finished shard, mapped, whose shapes and cameras have been checked.

    Args:
        path: The file.
        seeds: Of its scenes, by the index.
        frames: Of each scene, by the index.
        resolution: Of the pictures, by the index.

    Raises:
        ValueError: It is missing, damaged, or not the one of the index.
    """

    def __init__(self, path: Path, seeds: list[int], frames: int, resolution: int) -> None:
        if not path.is_file():
            raise ValueError(f"{path} is missing; {SHARD_REMEDY}")
        with naming_damage(path, SHARD_REMEDY):
            self._file = safe_open(path, framework="pt")
            metas = parse_json(self._file.metadata()["scenes"], "its metadata", "")
            if [meta["seed"] for meta in metas] != seeds:
                raise ValueError("it has not the seeds that the index says")
            for meta in metas:
                one_of(meta["level"], tuple(LEVELS))
            self.metas: list[dict[str, Any]] = metas
            self.words = [stored_words(meta) for meta in metas]
            picture = (len(seeds), frames, resolution, resolution)
            self._check("images", "U8", (*picture, 3))
            self._check("instances", "U16", picture)
            self._check("depths_mm", "U16", picture)
            self._check("world_from_cam", "F32", (len(seeds), frames, 4, 4))
            self._check("intrinsics", "F32", (len(seeds), frames, 3, 3))
        self._check_cameras(path, seeds, resolution)

    def read(self, name: str, row: int) -> Tensor:
        """A tensor of one scene."""
        return self._file.get_slice(name)[row]

    def read_frames(self, name: str, row: int, frames: Sequence[int]) -> Tensor:
        """A tensor of some frames of one scene; the others are not read."""
        whole = self._file.get_slice(name)
        return torch.stack([whole[row, frame] for frame in frames])

    def _check(self, name: str, dtype: str, shape: tuple[int, ...]) -> None:
        found = self._file.get_slice(name)
        if (found.get_dtype(), tuple(found.get_shape())) != (dtype, shape):
            raise ValueError(
                f"{name} is {found.get_dtype()} {found.get_shape()}, wanted {dtype} {shape}"
            )

    def _check_cameras(self, path: Path, seeds: list[int], resolution: int) -> None:
        for row, seed in enumerate(seeds):
            poses, intrinsics = self.read("world_from_cam", row), self.read("intrinsics", row)
            for frame, (pose, matrix) in enumerate(zip(poses, intrinsics, strict=True)):
                where = f"{path}: frame {frame} of seed {seed}"
                if fault := rigid_fault(pose):
                    raise ValueError(f"{where} {fault}; {SHARD_REMEDY}")
                check_intrinsics(matrix, where=where, width=resolution, height=resolution)


def add_to_index(folder: Path, shard: int, record: ShardRecord) -> None:
    """Add a finished shard to the index."""
    index = read_index(folder)
    index["shards"][shard_name(shard)] = vars(record)
    index["shards"] = dict(sorted(index["shards"].items()))
    write_json(folder / INDEX, index)
