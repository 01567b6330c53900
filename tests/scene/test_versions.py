"""Scene folders of older versions are read, and say the same."""

import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
import torch

import instok3d
from instok3d.scene.objects import SceneObject
from instok3d.scene.scene import Scene
from instok3d.scene.versions import UPGRADES, VERSION, upgraded
from instok3d.scene.visibility import Sight
from made_scene import made_scene, made_tokens

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
FILE = Path("room.itk/scene.json")


@pytest.mark.parametrize("version", range(1, VERSION))
def test_every_older_version_is_read_as_the_scene_that_was_written(version: int):
    # Each folder was written by the program of its time from the scene of made_scene.py.
    loaded, made = instok3d.load(GOLDEN / f"scene_v{version}"), made_scene(made_tokens())
    for name, value in vars(made.gaussians).items():
        torch.testing.assert_close(vars(loaded.gaussians)[name], value)
    torch.testing.assert_close(loaded.tokens.assignment, made.tokens.assignment)
    assert torch.equal(loaded.photos, made.photos)
    assert_same([plain(item) for item in loaded.objects], [plain(item) for item in made.objects])
    assert loaded.near_far == pytest.approx(made.near_far)


def plain(item: SceneObject) -> dict[str, Any]:
    """All of an object in plain values; where it is seen may be found late."""
    sight = Sight(item.visible_in, item.best_view, item.sight.masks)
    return asdict(replace(item, sight=sight))


def assert_same(found: Any, wanted: Any, where: str = "") -> None:
    """Equal, and numbers close: those of the scene made here may differ in their last bits from
    those of the processor that wrote the folder."""
    assert type(found) is type(wanted), where
    if isinstance(found, dict):
        assert found.keys() == wanted.keys(), where
    if isinstance(found, dict | list | tuple):
        assert len(found) == len(wanted), where
        for key in found if isinstance(found, dict) else range(len(found)):
            assert_same(found[key], wanted[key], f"{where}.{key}")
    elif isinstance(found, torch.Tensor):
        torch.testing.assert_close(found, wanted, msg=where)
    elif isinstance(found, float):
        assert found == pytest.approx(wanted, rel=1e-5, abs=1e-6), where
    else:
        assert found == wanted, where


def test_there_is_an_upgrade_and_a_golden_folder_for_every_older_version():
    assert sorted(UPGRADES) == list(range(1, VERSION))
    assert [path.name for path in sorted(GOLDEN.glob("scene_v*"))] == [
        f"scene_v{version}" for version in range(1, VERSION)
    ]


def test_an_old_scene_saved_again_is_one_of_today(tmp_path: Path):
    instok3d.load(GOLDEN / "scene_v1").save(tmp_path / "new.itk")
    replace(made_scene(made_tokens()), semantics={}).save(tmp_path / "made.itk")
    for file in ("scene.json", "cameras.json", "objects.json"):
        new, made = (
            json.loads((tmp_path / name / file).read_text()) for name in ("new.itk", "made.itk")
        )
        if file == "scene.json":  # which files there are; what is in them is compared as read
            new["sha256"], made["sha256"] = sorted(new["sha256"]), sorted(made["sha256"])
        assert_same(new, made, file)
    photo = Path("inputs/001.png")
    assert (tmp_path / "new.itk" / photo).read_bytes() == (
        tmp_path / "made.itk" / photo
    ).read_bytes()


@pytest.mark.parametrize("version", [0, VERSION + 1, "1", True, None, 1.0])
def test_an_unknown_version_is_refused(version: object):
    with pytest.raises(ValueError, match=r"room\.itk/scene\.json: this program reads scenes of"):
        upgraded({"version": version}, FILE)
    with pytest.raises(ValueError, match="not None"):
        upgraded([], FILE)


def test_photos_are_looked_for_nowhere_else(tmp_path: Path, scene: Scene):
    scene.save(tmp_path / "room.itk")
    file = tmp_path / "room.itk" / "scene.json"
    header = json.loads(file.read_text())
    for elsewhere in ("../other", "/etc", 3):
        file.write_text(json.dumps(header | {"inputs_folder": elsewhere}))
        with pytest.raises(ValueError, match="not 'inputs'"):
            instok3d.load(tmp_path / "room.itk")


@pytest.mark.parametrize("near_far", [[0, 1], [2, 1], [1, float("nan")], [1], None, "ab"])
def test_depth_limits_that_cannot_be_are_refused(tmp_path: Path, scene: Scene, near_far: object):
    scene.save(tmp_path / "room.itk")
    file = tmp_path / "room.itk" / "scene.json"
    header = json.loads(file.read_text())
    file.write_text(json.dumps(header | {"near_far": near_far}))
    with pytest.raises(ValueError, match=r"scene\.json|is damaged"):
        instok3d.load(tmp_path / "room.itk")


def test_an_old_folder_without_its_photos_is_incomplete(tmp_path: Path):
    shutil.copytree(GOLDEN / "scene_v1", tmp_path / "room.itk")
    shutil.rmtree(tmp_path / "room.itk" / "previews")
    with pytest.raises(FileNotFoundError, match=r"incomplete: .*000\.png is missing"):
        instok3d.load(tmp_path / "room.itk")
