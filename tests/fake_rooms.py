"""Box rooms by hand-made ray casting: true depth, ids and cameras at any size, no files."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import torch

from instok3d.data.scenes import SceneFrames


class FakeRooms:
    """Rooms of 4 x 3 x 5 m with three boxes of plain colours; 16 frames on a line."""

    def __init__(self, count: int = 3, size: int = 32, first_seed: int = 0) -> None:
        self.seeds = tuple(range(first_seed, first_seed + count))
        self.size = size

    def __len__(self) -> int:
        return len(self.seeds)

    def name_of(self, number: int) -> str:
        return str(self.seeds[number])

    def num_frames(self, number: int) -> int:
        return 16

    def frames(self, number: int, chosen: Sequence[int]) -> SceneFrames:
        return take_frames(fake_scene(self.seeds[number], self.size), chosen)


def take_frames(scene: SceneFrames, chosen: Sequence[int]) -> SceneFrames:
    tensors = {k: v for k, v in vars(scene).items() if k not in ("name", "words")}
    return SceneFrames(name=scene.name, **{k: v[list(chosen)] for k, v in tensors.items()})


@lru_cache(maxsize=32)
def fake_scene(seed: int, size: int, num_frames: int = 16) -> SceneFrames:
    rng = np.random.default_rng(seed)
    wall_color = rng.uniform(0.5, 0.8, 3)
    centers = np.stack([[-1.0, 0.0, 1.0], [1.1] * 3, rng.uniform(2.5, 3.5, 3)], axis=1)
    halves = np.stack([rng.uniform(0.25, 0.4, 3)] * 3, axis=1)
    colors = rng.uniform(0.05, 1.0, (3, 3))
    intrinsics = np.array([[size * 0.7, 0, size / 2], [0, size * 0.7, size / 2], [0, 0, 1.0]])
    rows, columns = np.mgrid[:size, :size] + 0.5
    rays = np.stack(
        [
            (columns - size / 2) / intrinsics[0, 0],
            (rows - size / 2) / intrinsics[1, 1],
            np.ones_like(rows),
        ],
        axis=-1,
    )
    images, instances, depths, poses = [], [], [], []
    for frame in range(num_frames):
        pose = np.eye(4)
        angle_rad = 0.02 * (frame - num_frames / 2)
        pose[:3, :3] = [
            [np.cos(angle_rad), 0, np.sin(angle_rad)],
            [0, 1, 0],
            [-np.sin(angle_rad), 0, np.cos(angle_rad)],
        ]
        pose[:3, 3] = [0.06 * (frame - num_frames / 2), 0.0, 0.1]
        directions = rays @ pose[:3, :3].T
        origin = pose[:3, 3]
        depth, ids = (
            _box_exit(origin, directions, [-2, -1.5, -1], [2, 1.5, 5]),
            np.zeros(rays.shape[:2]),
        )
        color = np.broadcast_to(wall_color, rays.shape).copy()
        for number in range(3):
            entry = _box_entry(origin, directions, centers[number], halves[number])
            hit = entry < depth
            depth = np.where(hit, entry, depth)
            ids[hit] = number + 1
            color[hit] = colors[number]
        images.append((color * 255).round().astype(np.uint8))
        instances.append(ids.astype(np.int32))
        depths.append(depth.astype(np.float32))
        poses.append(pose)
    return SceneFrames(
        name=str(seed),
        images=torch.from_numpy(np.stack(images)),
        instances=torch.from_numpy(np.stack(instances)),
        depths_m=torch.from_numpy(np.stack(depths)),
        world_from_cam=torch.from_numpy(np.stack(poses)),
        intrinsics=torch.from_numpy(np.stack([intrinsics] * num_frames)),
    )


def _box_exit(origin, directions, low, high):
    with np.errstate(divide="ignore"):
        far = np.maximum((low - origin) / directions, (high - origin) / directions)
    return far.min(axis=-1)


def _box_entry(origin, directions, center, half):
    with np.errstate(divide="ignore"):
        a = (center - half - origin) / directions
        b = (center + half - origin) / directions
    entry, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
    return np.where((entry < leave) & (entry > 0), entry, np.inf)
