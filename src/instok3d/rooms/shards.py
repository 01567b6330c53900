"""Shards: 16 seeds of scenes in one safetensors file, and the index rooms.json beside them."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from instok3d.files import write_json, write_safetensors
from instok3d.rooms.camera_path import FRAMES
from instok3d.rooms.scene import RenderedScene
from instok3d.rooms.seeding import GENERATOR_VERSION

FORMAT = "instok3d-rooms-1"
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


def new_index(resolution: int, level: str) -> dict[str, Any]:
    """The index of a folder without shards."""
    return {
        "format": FORMAT, "generator_version": GENERATOR_VERSION, "frames": FRAMES,
        "resolution": resolution, "level": level, "shards": {},
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
    try:
        index = json.loads(path.read_text())
    except ValueError as error:
        raise ValueError(
            f"{path} is damaged ({error}); delete it and make the rooms again"
        ) from error
    if not isinstance(index, dict) or index.get("format") != FORMAT:
        raise ValueError(f"{path} is not an index of rooms: its format is not {FORMAT!r}")
    missing = [key for key in new_index(0, "") if key not in index]
    if missing:
        raise ValueError(
            f"{path} is damaged: {', '.join(missing)} missing; delete it and make the rooms again"
        )
    return index


def add_to_index(folder: Path, shard: int, record: ShardRecord) -> None:
    """Add a finished shard to the index."""
    index = read_index(folder)
    index["shards"][shard_name(shard)] = vars(record)
    index["shards"] = dict(sorted(index["shards"].items()))
    write_json(folder / INDEX, index)
