"""A corner of a room: a floor, a wall, a ball before both; hidden parts of floor and wall lack."""

from dataclasses import replace

import torch
from torch import Tensor

from instok3d.geometry.cameras import project, transform_points
from instok3d.geometry.spherical_harmonics import SH_CONSTANT
from instok3d.photos.pixel_map import fit_pixels
from instok3d.scene.from_gaussians import scene_from_gaussians
from instok3d.scene.record import Provenance, SceneView
from instok3d.scene.scene import Scene
from instok3d.types import Cameras, Gaussians

HEIGHT, WIDTH = 48, 64
FLOOR, WALL, BALL, TABLE = 1, 2, 3, 4
CENTER, RADIUS = (0.0, 0.55, 3.0), 0.42


def sheet(origin: list, first: list, second: list, step: float) -> Tensor:
    """Points on a rectangle."""
    origin_, along, across = (torch.tensor(each) for each in (origin, first, second))
    u = torch.arange(0, float(along.norm()), step)[:, None, None] * along / along.norm()
    v = torch.arange(0, float(across.norm()), step)[None, :, None] * across / across.norm()
    return (origin_ + u + v).reshape(-1, 3)


def cameras() -> Cameras:
    intrinsics = torch.tensor([[60.0, 0, WIDTH / 2], [0, 60, HEIGHT / 2], [0, 0, 1]])
    cam_from_world = torch.eye(4).repeat(2, 1, 1)
    cam_from_world[1, 0, 3] = -0.15
    return Cameras(cam_from_world, intrinsics.expand(2, 3, 3))


def corner_scene(*, hidden: bool = False, table: bool = False) -> Scene:
    """The corner from two views; the world is the first camera's, y down.

    Args:
        hidden: Floor and wall go on behind the ball, as in the real room.
        table: A table top behind the ball to the right, whose edge the ball hides, is there too.
    """
    parts = {
        FLOOR: sheet([-3.0, 1.0, 1.2], [6.0, 0, 0], [0, 0, 3.8], 0.06),
        WALL: sheet([-3.5, -2.5, 5.0], [7.0, 0, 0], [0, 3.5, 0], 0.06),
        BALL: torch.nn.functional.normalize(
            torch.randn(500, 3, generator=torch.Generator().manual_seed(0)), dim=1
        ) * RADIUS + torch.tensor(CENTER),
    }  # fmt: skip
    if table:
        parts[TABLE] = sheet([0.1, 0.3, 3.5], [1.5, 0, 0], [0, 0, 0.8], 0.05)
    means = torch.cat(list(parts.values()))
    ids = torch.cat([torch.full((len(each),), number) for number, each in parts.items()])
    if not hidden:
        kept = (ids == BALL) | ~_behind_the_ball(means)
        means, ids = means[kept], ids[kept]
    sizes = {FLOOR: (0.05, 0.002, 0.05), WALL: (0.05, 0.05, 0.002), BALL: (0.05,) * 3,
             TABLE: (0.04, 0.002, 0.04)}  # fmt: skip
    count = len(means)
    sh = torch.zeros(count, 4, 3)
    sh[:, 0] = (_colors(means, ids) - 0.5) / SH_CONSTANT
    gaussians = Gaussians(
        means,
        torch.tensor([1.0, 0, 0, 0]).expand(count, 4),
        torch.stack([torch.tensor(sizes[number]) for number in ids.tolist()]),
        torch.full((count,), 0.95),
        sh,
        torch.zeros(count, dtype=torch.long),
    )
    made = Provenance("test", "none", "", seed=0)
    bare = scene_from_gaussians(gaussians, ids, provenance=made, height=HEIGHT, width=WIDTH)
    views = tuple(
        SceneView(f"{index}.jpg", "0" * 64, fit_pixels(HEIGHT, WIDTH, HEIGHT, WIDTH))
        for index in range(2)
    )
    photos = torch.zeros(2, HEIGHT, WIDTH, 3, dtype=torch.uint8)
    return replace(bare, cameras=cameras(), views=views, photos=photos, near_far=(0.1, 100.0))


def _colors(means: Tensor, ids: Tensor) -> Tensor:
    """The floor becomes lighter with the distance, the wall to the right."""
    colors = torch.zeros(len(means), 3)
    colors[ids == FLOOR] = torch.tensor([0.6, 0.4, 0.2])
    colors[ids == FLOOR] += 0.08 * (means[ids == FLOOR, 2:] - 3)
    colors[ids == WALL] = torch.tensor([0.3, 0.4, 0.6]) + 0.05 * means[ids == WALL, :1]
    colors[ids == BALL] = torch.tensor([0.9, 0.1, 0.1])
    colors[ids == TABLE] = torch.tensor([0.1, 0.8, 0.1])
    return colors


def _behind_the_ball(means: Tensor) -> Tensor:
    """What no view sees for the ball."""
    seen = torch.zeros(len(means), dtype=torch.bool)
    middle = torch.tensor([CENTER])
    for view in range(2):
        camera = cameras().view(view)
        local, own = (transform_points(camera.cam_from_world[0], each) for each in (means, middle))
        pixel, center = (project(each, camera.intrinsics[0]) for each in (local, own))
        radius = 60 * RADIUS / float(own[0, 2])
        seen |= ((pixel - center).norm(dim=1) > 0.9 * radius) | (local[:, 2] < own[0, 2])
    return ~seen
