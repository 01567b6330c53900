import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import instok3d
from instok3d.cli import main
from instok3d.cli.info import axes
from instok3d.formats.statements import scene_comments
from instok3d.geometry.cameras import invert_rigid, rigid
from instok3d.geometry.registration import skew
from instok3d.photos.camera_files import read_cameras
from instok3d.scene.paths import look_at, orbit
from instok3d.scene.scene import Scene
from instok3d.scene.vertical import STATED, Vertical, find_vertical, given_up
from made_scene import made_scene, made_tokens

DOWN = torch.tensor([0.0, 0.0, -1.0])


def level_cameras(yaws_deg: list[float], pitch_deg: float = 0.0) -> torch.Tensor:
    """Cameras at the origin of a z-up world, turned about z and tilted down."""
    yaw_rad = torch.tensor(yaws_deg).deg2rad()
    pitch_rad = torch.full_like(yaw_rad, math.radians(pitch_deg))
    forward = torch.stack(
        [yaw_rad.cos() * pitch_rad.cos(), yaw_rad.sin() * pitch_rad.cos(), -pitch_rad.sin()], dim=1
    )
    return look_at(torch.zeros_like(forward), forward, DOWN)


def turned(cam_from_world: torch.Tensor, rotation: torch.Tensor) -> torch.Tensor:
    """The same cameras in a world that is turned."""
    return cam_from_world @ invert_rigid(rigid(rotation, torch.zeros(3)))


def rotation_about(axis: list[float], angle_deg: float) -> torch.Tensor:
    unit = torch.nn.functional.normalize(torch.tensor(axis).float(), dim=0)
    return torch.linalg.matrix_exp(math.radians(angle_deg) * skew(unit))


@pytest.mark.parametrize("pitch_deg", [-20.0, 0.0, 25.0])
def test_up_is_found_however_far_the_cameras_are_tilted(pitch_deg: float):
    vertical = find_vertical(level_cameras([0, 30, 60, 90], pitch_deg), "given cameras")
    assert vertical.up == (0.0, 0.0, 1.0)
    assert vertical.confidence > 0.8


def test_up_of_a_world_without_an_upright_axis_is_found_too():
    rotation = rotation_about([1, 2, 0.5], 40)
    cameras = turned(level_cameras([0, 40, 80, 120], 15), rotation)
    vertical = find_vertical(cameras, "given cameras")
    cosine = float(torch.tensor(vertical.up) @ rotation[:, 2])
    assert math.degrees(math.acos(min(1.0, cosine))) < 1
    assert vertical.is_stated


def test_up_turns_with_the_world():
    # y up, as of OpenGL worlds: z goes to y.
    cameras = turned(level_cameras([10, 50, 100], 10), rotation_about([1, 0, 0], -90))
    assert find_vertical(cameras, "given cameras").up == (0.0, 1.0, 0.0)


def test_cameras_that_look_one_way_do_not_tell_how_far_they_are_tilted():
    assert find_vertical(level_cameras([0], 20), "given cameras").confidence < STATED
    assert find_vertical(level_cameras([0, 0, 0, 0], 20), "given cameras").confidence < STATED


def test_cameras_held_anyhow_do_not_tell_what_is_up(rng: torch.Generator):
    rotations = torch.linalg.qr(torch.randn(20, 8, 3, 3, generator=rng))[0]
    rotations = rotations * torch.det(rotations)[..., None, None]
    for chosen in rotations:
        assert not find_vertical(rigid(chosen, torch.zeros(8, 3)), "given cameras").is_stated


def test_cameras_above_a_table_that_look_straight_down_tell_no_sign():
    about_z = torch.stack([rotation_about([0, 0, 1], angle) for angle in (0.0, 90, 180, 270)])
    assert not find_vertical(rigid(about_z, torch.zeros(4, 3)), "given cameras").is_stated


def test_unposed_photos_have_the_first_cameras_up_and_tell_how_far_to_trust_it():
    level = level_cameras([0, 30, 60, 90])
    tilted = level_cameras([0, 30, 60, 90], 35)
    first, second = (
        find_vertical(cameras @ invert_rigid(cameras[:1]), "first camera")
        for cameras in (level, tilted)
    )
    assert first.up == second.up == (0.0, -1.0, 0.0)
    assert first.confidence > 0.8
    assert second.confidence < 0.1


def given_scene(cam_from_world: torch.Tensor) -> Scene:
    return made_scene(made_tokens(len(cam_from_world)), cam_from_world=cam_from_world)


def test_files_state_up_where_it_is_known_and_nothing_else():
    known = scene_comments(given_scene(level_cameras([0, 40, 80], 20)))
    assert "Vertical axis: 0 0 1" in known
    unknown = scene_comments(given_scene(level_cameras([0, 0], 20)))
    assert not any("Vertical axis" in line for line in unknown)
    assert not any("y down" in line for line in (*known, *unknown))
    assert "Vertical axis: 0 -1 0" in scene_comments(made_scene(made_tokens()))


def test_a_z_up_world_of_reported_cameras_is_told_as_such(shared: Path):
    cameras = read_cameras(shared / "data/reported_cases/11/transforms.json")
    vertical = find_vertical(
        torch.stack([each.cam_from_world for each in cameras.cameras]).float(), "given cameras"
    )
    # This world has the first camera level, which in truth looked some 20 degrees down.
    assert vertical.up[2] > 0.93
    assert vertical.is_stated


def test_a_scene_keeps_its_vertical(tmp_path: Path):
    scene = replace(
        made_scene(made_tokens()), vertical=Vertical((0.6, 0.0, 0.8), "given cameras", 0.7)
    )
    scene.save(tmp_path / "room.itk")
    header = json.loads((tmp_path / "room.itk/scene.json").read_text())
    assert header["vertical"] == {"up": [0.6, 0, 0.8], "source": "given cameras", "confidence": 0.7}
    assert instok3d.load(tmp_path / "room.itk").vertical == scene.vertical


@pytest.mark.parametrize(
    "change", [{"up": [0, 0, 2]}, {"confidence": 2}, {"source": "a guess"}, {"confidence": None}]
)
def test_a_vertical_that_cannot_be_is_refused(tmp_path: Path, scene: Scene, change: dict):
    scene.save(tmp_path / "room.itk")
    file = tmp_path / "room.itk" / "scene.json"
    header = json.loads(file.read_text())
    header["vertical"] |= change
    file.write_text(json.dumps(header))
    with pytest.raises(ValueError, match=r"scene\.json: vertical is|damaged"):
        instok3d.load(tmp_path / "room.itk")


def test_an_orbit_stands_upright_where_the_middle_photo_does_not():
    cameras = level_cameras([0, 40, 80, 120, 160], 20)
    roll = torch.eye(4).repeat(5, 1, 1)
    roll[2, :3, :3] = rotation_about([0, 0, 1], 8)
    scene = given_scene(roll @ cameras)
    assert scene.vertical.is_stated
    right = orbit(scene, 4).cam_from_world[:, 0, :3]
    assert float((right @ DOWN).abs().max()) < 0.02
    # The photo itself leans by 8 degrees.
    assert abs(float(scene.cameras.cam_from_world[2, 0, :3] @ DOWN)) > 0.1


@pytest.mark.parametrize(
    ("said", "up"),
    [
        ("z", (0, 0, 1)),
        ("-y", (0, -1, 0)),
        (["+X"], (1, 0, 0)),
        (["0", "-2", "0"], (0, -1, 0)),
        ("0, 3, 4", (0, 0.6, 0.8)),
        ((0.0, 0.0, -7.0), (0, 0, -1)),
    ],
)
def test_up_is_stated_as_an_axis_or_as_numbers(said: str | list, up: tuple):
    found = given_up(said)
    assert found.up == pytest.approx(up)
    assert (found.source, found.confidence, found.is_stated) == ("given", 1.0, True)


@pytest.mark.parametrize("said", ["", "w", "zz", "0 0 0", "1 2", ["1", "2", "x"], "nan 0 1", "--z"])
def test_what_is_no_direction_is_refused(said: str | list):
    with pytest.raises(ValueError, match="up must be an axis such as z or -y"):
        given_up(said)


def test_another_up_is_an_edit_that_turns_orbits_and_exports_use(tmp_path: Path):
    scene = made_scene(made_tokens())
    upright = scene.with_up("z")
    assert upright.vertical.up == (0, 0, 1)
    assert upright.edits == ("up is (0, 0, 1)",)
    assert "Vertical axis: 0 0 1" in scene_comments(upright)
    assert "up is (0, 0, 1) as it was given" in axes(upright)
    # Turned about z, an object keeps its z.
    turned_ = upright.move(1, yaw=90)
    before, after = (each.object(1).obb.center for each in (scene, turned_))
    assert after[2] == pytest.approx(before[2], abs=1e-5)
    assert scene.move(1, yaw=90).object(1).obb.center[1] == pytest.approx(before[1], abs=1e-5)
    # An orbit's pictures stand upright: up is drawn upwards.
    for view in orbit(scene.with_up("x"), 3).cam_from_world:
        assert float(view[:3, :3] @ torch.tensor([1.0, 0, 0]) @ torch.tensor([0.0, -1, 0])) > 0.5
    upright.save(tmp_path / "room.itk")
    loaded = instok3d.load(tmp_path / "room.itk")
    assert loaded.vertical == upright.vertical
    assert loaded.undo().vertical == scene.vertical


def test_the_commands_take_another_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    room = tmp_path / "room.itk"
    made_scene(made_tokens()).save(room)
    assert main(["objects", str(room), "--json", "--up", "z"]) == 0
    assert json.loads(capsys.readouterr().out)["up"] == [0, 0, 1]
    assert main(["export", str(room), "-o", str(tmp_path / "a.ply"), "--up", "0", "0", "-1"]) == 0
    assert b"Vertical axis: 0 0 -1" in (tmp_path / "a.ply").read_bytes()[:2000]
    line = ["render", str(room), "-o", str(tmp_path / "a.png"), "--path", "orbit", "--frames", "2"]
    assert main([*line, "--up=-x"]) == 0
    assert main([*line, "--up", "w", "--overwrite"]) == 2
    assert "up must be an axis" in capsys.readouterr().err
    assert instok3d.load(room).vertical.source == "first camera"
    assert main(["edit", str(room), "up", "--direction=-z"]) == 0
    assert instok3d.load(room).vertical.up == (0, 0, -1)
    assert main(["edit", str(room), "up"]) == 2
