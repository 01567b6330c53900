"""A hand-made room of three flat things, and a model that knows all about it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from fake_rooms import take_frames
from instok3d.data.sample import Sample
from instok3d.data.scenes import SceneFrames
from instok3d.geometry.cameras import invert_rigid, rigid, transform_points, unproject
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.types import Anchors, Cameras, Gaussians, Geometry, TokenGroups, Views

SIZE = 32
FOCAL = 30.0


@dataclass(frozen=True)
class FlatRoom:
    """A wall (id 1) and two boards before it (2 and 3), seen by 16 cameras on a line."""

    images: np.ndarray
    instances: np.ndarray
    depths_m: np.ndarray
    world_from_cam: np.ndarray
    intrinsics: np.ndarray
    meta: dict[str, Any]


class FlatRooms:
    """Rooms as a data set gives them."""

    def __init__(self, seeds: list[int], levels: list[str]):
        self.seeds = seeds
        self.rooms = [flat_room(s, level) for s, level in zip(seeds, levels, strict=True)]

    def __len__(self) -> int:
        return len(self.rooms)

    def name_of(self, number: int) -> str:
        return str(self.seeds[number])

    def level_of(self, number: int) -> str:
        return self.rooms[number].meta["level"]

    def num_frames(self, number: int) -> int:
        return 16

    def frames(self, number: int, chosen: Sequence[int]) -> SceneFrames:
        room = vars(self.rooms[number]).items()
        arrays = {key: torch.from_numpy(value) for key, value in room if key != "meta"}
        return take_frames(SceneFrames(name=self.name_of(number), **arrays), chosen)


def flat_room(seed: int = 0, level: str = "easy") -> FlatRoom:
    y, x = np.mgrid[0:SIZE, 0:SIZE] + 0.5
    rays = np.stack([(x - SIZE / 2) / FOCAL, (y - SIZE / 2) / FOCAL, np.ones_like(x)], axis=-1)
    images, instances, depths, cameras = [], [], [], []
    for frame in range(16):
        eye = np.array([0.08 * frame - 0.6, 0.01 * frame, 0.0])
        depth, ids = np.full((SIZE, SIZE), 3.0), np.ones((SIZE, SIZE), dtype=np.int64)
        for name, z, left, top, right, bottom in (
            (2, 2.5, -0.9, -0.7, -0.1, 0.5),
            (3, 2.2, 0.2, -0.4, 0.8, 0.7),
        ):
            at = rays[..., :2] * z + eye[:2]
            inside = (at > [left, top]).all(-1) & (at < [right, bottom]).all(-1)
            depth[inside], ids[inside] = z, name
        points = rays * depth[..., None] + eye
        waves = np.sin(2 * points[..., :1] + [0, 1, 2]) * np.cos(1.5 * points[..., 1:2])
        base = np.array([[0.6, 0.6, 0.5], [0.8, 0.2, 0.2], [0.2, 0.3, 0.8]])[ids - 1]
        images.append(np.clip(base + 0.1 * waves, 0, 1) * 255)
        instances.append(ids)
        depths.append(depth)
        pose = np.eye(4)
        pose[:3, 3] = eye
        cameras.append(pose)
    intrinsics = np.array([[FOCAL, 0, SIZE / 2], [0, FOCAL, SIZE / 2], [0, 0, 1]])
    return FlatRoom(
        images=np.stack(images).round().astype(np.uint8),
        instances=np.stack(instances),
        depths_m=np.stack(depths),
        world_from_cam=np.stack(cameras),
        intrinsics=np.repeat(intrinsics[None], 16, axis=0),
        meta={"seed": seed, "level": level},
    )


def oracle(sample: Sample, *, unit: float = 1.0, stride: int = 1) -> Callable[[Views], TokenGroups]:
    """A model that answers with the truth of one sample: a Gaussian and anchor for each pixel.

    Args:
        sample: The truth.
        stride: Only every so many rows and columns get a Gaussian, a larger one.
        unit: Lengths are divided by it, as if the model had guessed another scale; its world
            stays the first camera.
    """
    context = sample.context
    assert context.depths is not None
    assert context.cam_from_world is not None
    assert context.intrinsics is not None
    depths = context.depths / unit
    cam_from_world = context.cam_from_world.clone()
    cam_from_world[..., :3, 3] /= unit
    points = transform_points(
        invert_rigid(cam_from_world), unproject(depths, context.intrinsics).flatten(2, 3)
    )
    pointmaps = points.view(*depths.shape, 3)
    grid = (slice(None), slice(None), slice(0, None, stride), slice(0, None, stride))
    means = pointmaps[grid].reshape(1, -1, 3)
    count = means.shape[1]
    assignment = torch.zeros(1, count, 6)
    assignment[0, torch.arange(count), sample.context_instances[grid].flatten()] = 1.0
    colors = context.images.permute(0, 1, 3, 4, 2)[grid].reshape(1, -1, 1, 3)
    sigma = 0.3 * stride * depths[grid].reshape(1, -1, 1) / FOCAL
    gaussians = Gaussians(
        means=means,
        quats=torch.tensor([1.0, 0, 0, 0]).expand(1, count, 4).contiguous(),
        scales=sigma.expand(1, count, 3).contiguous(),
        opacities=torch.full((1, count), 0.8),
        sh=(colors - 0.5) / 0.28209479,
        anchor_index=torch.arange(count)[None],
    )
    geometry = Geometry(
        features=torch.zeros(1, depths.shape[1], 1, 1),
        depths=depths,
        pointmaps=pointmaps,
        confidences=torch.ones_like(depths),
        cameras=Cameras(cam_from_world, context.intrinsics),
    )
    anchors = Anchors(means, torch.zeros(1, count, 2), torch.zeros(1, count, dtype=torch.long))
    groups = TokenGroups(anchors, torch.zeros(1, 5, 2), assignment, gaussians, geometry)
    return lambda views: groups


def in_another_world(sample: Sample) -> Sample:
    """The sample with its world turned and shifted."""
    quat = torch.tensor([0.9, 0.2, -0.3, 0.1])
    change = rigid(quat_to_matrix(quat), torch.tensor([0.4, -0.2, 0.7]))

    def moved(views: Views) -> Views:
        assert views.cam_from_world is not None
        return replace(views, cam_from_world=views.cam_from_world @ change)

    return replace(sample, context=moved(sample.context), target=moved(sample.target))
