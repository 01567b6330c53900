from dataclasses import replace

import pytest
import torch

from imported_scene import imported_scene
from instok3d.geometry.cameras import project, transform_points
from instok3d.scene.scene import Scene
from instok3d.viewer.cameras import first_stand, stand_of_view, typical_distance
from made_scene import HEIGHT, WIDTH, made_scene, made_tokens


@pytest.fixture
def scene() -> Scene:
    return made_scene(made_tokens())


def test_a_stand_is_the_camera_of_its_photo(scene: Scene):
    turn = torch.tensor([[0.8, 0, 0.6, 0.1], [0, 1, 0, 0.2], [-0.6, 0, 0.8, 0.3], [0, 0, 0, 1]])
    poses = scene.cameras.cam_from_world.clone()
    poses[1] = turn @ poses[1]
    moved = replace(scene, cameras=replace(scene.cameras, cam_from_world=poses))
    for view in (0, 1):
        stand = stand_of_view(moved, view)
        torch.testing.assert_close(stand.cam_from_world(), poses[view], atol=1e-6, rtol=0)
        torch.testing.assert_close(stand.intrinsics(HEIGHT, WIDTH), scene.cameras.intrinsics[view])
        ahead = transform_points(poses[view], torch.tensor([stand.look_at(2.5)]))
        torch.testing.assert_close(ahead, torch.tensor([[0.0, 0, 2.5]]), atol=1e-5, rtol=0)
        up = poses[view][:3, :3] @ torch.tensor(stand.up())
        torch.testing.assert_close(up, torch.tensor([0.0, -1, 0]), atol=1e-6, rtol=0)


def test_one_begins_at_the_first_photo_or_where_all_is_seen(scene: Scene):
    assert first_stand(scene) == stand_of_view(scene, 0)
    bare = imported_scene()
    stand = first_stand(bare)
    pixels = project(
        transform_points(stand.cam_from_world(), bare.gaussians.means), stand.intrinsics(60, 80)
    )
    inside = (pixels > 0).all(1) & (pixels < torch.tensor([80.0, 60.0])).all(1)
    assert inside.float().mean() > 0.8


def test_an_empty_scene_has_a_stand_too(scene: Scene):
    nothing = scene.gaussians.rows(slice(0, 0))
    bare = replace(scene, gaussians=nothing, objects=(), views=(), cameras=scene.cameras.views([]))
    assert typical_distance(bare) > 0
    assert first_stand(bare).vertical_fov_rad > 0
