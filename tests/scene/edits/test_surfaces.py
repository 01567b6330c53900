"""Planes among what views show."""

import pytest
import torch

from corner_scene import BALL, FLOOR, HEIGHT, WALL, WIDTH, corner_scene
from instok3d.render import render
from instok3d.scene.edits.surfaces import Look, find_planes, look_at
from instok3d.scene.scene import Scene
from instok3d.types import Gaussians


@pytest.fixture(scope="module")
def corner() -> Scene:
    return corner_scene(hidden=True).remove(BALL)


def seen(scene: Scene, gaussians: Gaussians, size: tuple[int, int] = (HEIGHT, WIDTH)) -> Look:
    """What the scene's input views show of Gaussians."""
    cameras = scene.cameras
    views = [cameras.view(number) for number in range(len(cameras.intrinsics))]
    return look_at([render(gaussians, view, *size) for view in views], cameras)


def test_floor_and_wall_are_found_where_they_are(corner: Scene):
    look = seen(corner, corner.gaussians)
    ids = corner.render(ids=True).ids
    assert ids is not None
    # The floor is y = 1 with up -y, the wall z = 5 and faces the cameras.
    for number, normal, offset in ((FLOOR, (0, -1, 0), -1.0), (WALL, (0, 0, -1), -5.0)):
        # Far from where both meet: there each has pixels and Gaussians that lie on the other.
        rows = torch.arange(HEIGHT)[:, None].expand(2, HEIGHT, WIDTH)
        rim = ((rows > 40) if number == FLOOR else (rows < 25)).float()
        planes = find_planes(corner.gaussians, look, rim)
        (plane,) = [
            each for each in planes if float(each.normal @ torch.tensor(normal).float()) > 0.99
        ]
        assert plane.offset == pytest.approx(offset, rel=0.02)
        assert plane.bounds_room
        assert float((ids[plane.inliers] == number).float().mean()) > 0.9


def test_nothing_and_small_pictures_hold_no_plane(corner: Scene):
    everywhere = torch.ones(2, HEIGHT, WIDTH)
    nothing = corner.gaussians.rows(slice(0, 0))
    look = seen(corner, nothing)
    assert find_planes(nothing, look, everywhere) == []
    look = seen(corner, corner.gaussians, (3, 4))
    assert find_planes(corner.gaussians, look, torch.ones(2, 3, 4)) == []
