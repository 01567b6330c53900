import json
import math
from pathlib import Path

import pytest
import torch

from instok3d.geometry.cameras import invert_rigid, project, transform_points
from instok3d.scene.paths import camera_path, look_at, orbit, through
from instok3d.scene.scene import Scene
from instok3d.types import Cameras


def test_a_camera_looks_at_its_target_by_hand():
    # From (2, 0, 0) at the origin with y down: forward is -x, right is down x forward = +z.
    center, target = torch.tensor([[2.0, 0, 0]]), torch.zeros(1, 3)
    cam_from_world = look_at(center, target, torch.tensor([0.0, 1, 0]))[0]
    rows = torch.tensor([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    torch.testing.assert_close(cam_from_world[:3, :3], rows)
    torch.testing.assert_close(cam_from_world @ torch.tensor([2.0, 0, 0, 1]), torch.eye(4)[3])


def test_an_orbit_keeps_its_target_in_the_middle_and_stays_near_the_photos(scene: Scene):
    cameras = orbit(scene, 8)
    middle = scene.cameras.cam_from_world[1]
    z = transform_points(middle, scene.gaussians.means)[:, 2]
    distance = z[z > 0].median()
    target = transform_points(invert_rigid(middle), torch.tensor([[0, 0, float(distance)]]))
    seen = transform_points(cameras.cam_from_world, target.expand(8, 1, 3))
    pixels = project(seen, cameras.intrinsics)[:, 0]
    principal_point = cameras.intrinsics[:, :2, 2]
    torch.testing.assert_close(pixels, principal_point, atol=1e-3, rtol=0)
    centers = invert_rigid(cameras.cam_from_world)[:, :3, 3]
    away = (centers - invert_rigid(middle)[:3, 3]).norm(dim=1)
    assert float(away.max()) <= 0.121 * float(distance)
    assert math.isclose(float(away[0]), float(away[4]), rel_tol=1e-4)


@pytest.mark.parametrize("frames", [0, -1, 10**12])
@pytest.mark.parametrize("name", ["orbit", "inputs"])
def test_a_path_of_no_or_endless_frames_is_refused(scene: Scene, name: str, frames: int):
    with pytest.raises(ValueError, match=f"frames must lie in 1..100000, got {frames}"):
        camera_path(scene, name, frames)


def test_a_file_of_cameras_of_impossible_pictures_is_refused(scene: Scene, tmp_path: Path):
    scene.save(tmp_path / "room.itk")
    entries = json.loads((tmp_path / "room.itk/cameras.json").read_text())
    file = tmp_path / "path.json"
    for height, width in ((0, 32), (10**6, 10**6), (-24, -32)):
        sized = [entry | {"height": height, "width": width} for entry in entries]
        file.write_text(json.dumps(sized))
        with pytest.raises(ValueError, match=r"path\.json: camera 0"):
            camera_path(scene, str(file), 1)


def test_a_flight_goes_from_input_to_input(scene: Scene):
    turned = torch.eye(4).repeat(3, 1, 1)
    angle_rad = torch.tensor([0.0, 0.4, 1.2])
    turned[:, 0, 0] = turned[:, 2, 2] = angle_rad.cos()
    turned[:, 0, 2], turned[:, 2, 0] = angle_rad.sin(), -angle_rad.sin()
    turned[:, 0, 3] = torch.tensor([0.0, 1, 5])
    inputs = Cameras(turned, scene.cameras.intrinsics[:1].expand(3, 3, 3))
    flight = through(inputs, 9)
    torch.testing.assert_close(flight.cam_from_world[::4], turned)
    # A quarter of the flight is half of the way to the second: half of its angle, between centres.
    between = flight.cam_from_world[2]
    assert math.atan2(float(between[0, 2]), float(between[0, 0])) == pytest.approx(0.2, abs=1e-6)
    centers = invert_rigid(turned)[:, :3, 3]
    torch.testing.assert_close(invert_rigid(between)[:3, 3], centers[:2].mean(dim=0))


@pytest.mark.parametrize("frames", [1, 2, 5])
def test_a_flight_of_one_input_stands_still(scene: Scene, frames: int):
    flight = through(scene.cameras.view(0), frames)
    torch.testing.assert_close(flight.cam_from_world, torch.eye(4).expand(frames, 4, 4))
    assert len(camera_path(scene, "through", frames).cameras.intrinsics) == frames
