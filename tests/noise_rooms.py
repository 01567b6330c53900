"""Rooms of the right shapes, with sound cameras and pictures of noise."""

from pathlib import Path

import numpy as np

from instok3d.rooms.scene import RenderedScene
from instok3d.rooms.shards import ShardRecord, add_to_index, shard_name, write_shard


def noise_scene(seed: int, size: int = 16) -> RenderedScene:
    rng = np.random.default_rng(seed)
    meta = {"seed": seed, "level": "easy", "room_type": "office", "instances": [{"stuff": False}]}
    intrinsics = np.array([[size, 0, size / 2], [0, size, size / 2], [0, 0, 1]], np.float32)
    return RenderedScene(
        images=rng.integers(0, 256, (16, size, size, 3), np.uint8),
        instances=rng.integers(0, 60_000, (16, size, size), np.uint16),
        depths_mm=rng.integers(0, 65_536, (16, size, size), np.uint16),
        world_from_cam=_noise_poses(rng),
        intrinsics=np.repeat(intrinsics[None], 16, axis=0),
        meta=meta,
    )


def put(folder: Path, shard: int, scenes: list[RenderedScene]) -> None:
    """A finished shard."""
    write_shard(folder / shard_name(shard), scenes)
    seeds = [scene.meta["seed"] for scene in scenes]
    add_to_index(folder, shard, ShardRecord(seeds, [], ["easy"] * len(seeds)))


def _noise_poses(rng: np.random.Generator) -> np.ndarray:
    rotations = np.linalg.qr(rng.normal(size=(16, 3, 3)))[0]
    rotations[:, :, 0] *= np.linalg.det(rotations)[:, None]
    poses = np.tile(np.eye(4), (16, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rotations, rng.normal(size=(16, 3))
    return poses.astype(np.float32)
