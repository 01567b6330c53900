"""`instok3d data rooms` and `instok3d data preview`: what they write and what they refuse."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("embreex")

from instok3d.cli import BAD_INPUT, OK, main
from instok3d.rooms import RoomDataset, generate, shards


@pytest.fixture
def small_shards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shards, "SHARD_SEEDS", 1)
    monkeypatch.setattr(generate, "SHARD_SEEDS", 1)


def rooms(folder: Path, *options: str) -> int:
    return main(["data", "rooms", "-o", str(folder), *options])


@pytest.mark.usefixtures("small_shards")
def test_rooms_are_made_resumed_and_shown(tmp_path, capsys):
    folder = tmp_path / "new" / "folder"
    few = ("--resolution", "32", "--workers", "1", "--level", "easy", "--seeds")
    assert rooms(folder, *few, "1:2") == OK
    shown = capsys.readouterr()
    assert shown.out == f"{folder}: 1 new rooms, 0 seeds rejected, 0 seeds already there\n"
    assert shown.err == ""  # no bar where there is no terminal
    assert rooms(folder, *few, "1:2") == OK
    assert "0 new rooms, 0 seeds rejected, 1 seeds already there" in capsys.readouterr().out
    scene = RoomDataset(folder).scene(0)
    assert (scene.seed, scene.level, scene.images.shape) == (1, "easy", (16, 32, 32, 3))

    assert main(["data", "preview", str(folder), "--views", "3"]) == OK
    assert capsys.readouterr().out == f"{folder / 'preview.png'}\n"
    sheet = np.array(Image.open(folder / "preview.png"))
    assert sheet.shape[1:] == (6 + 3 * (128 + 6), 3)
    other = tmp_path / "sheet.png"
    for _ in range(2):  # the second replaces the first
        assert main(["data", "preview", str(folder), "-o", str(other), "--views", "3"]) == OK
    np.testing.assert_array_equal(np.array(Image.open(other)), sheet)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--seeds", "20:10"], "--seeds '20:10' is no range"),
        (["--seeds", "5:5"], "--seeds '5:5' is no range"),
        (["--seeds", "-3:5"], "no range"),
        (["--seeds", "many"], "--seeds 'many' is no range; write first:last+1, such as 0:2000"),
        (["--seeds", "3999999:4000001"], "seed 4000000 is outside 0 to 3,999,999"),
        (["--resolution", "0"], "resolution 0 is outside 16 to 2048 pixels"),
        (["--resolution", "-64"], "resolution"),
        (["--workers", "0"], "workers must be 1 or more, got 0"),
    ],
)
def test_bad_options_are_one_sentence_and_write_nothing(tmp_path, capsys, options, says):
    words = [f"{options[0]}={options[1]}"]
    assert rooms(tmp_path / "rooms", *words) == BAD_INPUT
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1
    assert not (tmp_path / "rooms").exists()


def test_an_unknown_level_is_refused_with_the_known_ones(tmp_path, capsys):
    assert rooms(tmp_path / "rooms", "--level", "cosy") == BAD_INPUT
    error = capsys.readouterr().err
    assert "cosy" in error
    assert "medium" in error
    assert not (tmp_path / "rooms").exists()


def test_a_file_in_place_of_the_folder_is_named(tmp_path, capsys):
    (tmp_path / "rooms").write_text("mine")
    assert rooms(tmp_path / "rooms") == BAD_INPUT
    assert "it is a file, not a folder" in capsys.readouterr().err
    assert (tmp_path / "rooms").read_text() == "mine"


def test_a_folder_that_cannot_be_written_is_named(tmp_path, capsys):
    if os.geteuid():
        tmp_path.chmod(0o500)
        folder = tmp_path / "rooms"
    else:  # root may write anywhere but into the kernel's own files
        folder = Path("/proc/rooms")
    assert rooms(folder, "--workers", "1") == BAD_INPUT
    error = capsys.readouterr().err
    assert "rooms" in error
    assert error.count("\n") == 1
    tmp_path.chmod(0o700)


def test_a_missing_ray_tracer_is_named_before_anything_is_written(tmp_path, capsys, monkeypatch):
    for name in ("embreex", "embreex.mesh_construction", "embreex.rtcore_scene"):
        monkeypatch.setitem(sys.modules, name, None)
    assert rooms(tmp_path / "rooms") == BAD_INPUT
    assert "pip install 'instok3d[rooms]'" in capsys.readouterr().err
    assert not (tmp_path / "rooms").exists()


def test_previews_that_cannot_be_made_are_one_sentence(tmp_path, capsys):
    assert main(["data", "preview", str(tmp_path)]) == BAD_INPUT
    assert f"no rooms.json in {tmp_path}" in capsys.readouterr().err
    (tmp_path / "rooms.json").write_text("{")
    assert main(["data", "preview", str(tmp_path)]) == BAD_INPUT
    error = capsys.readouterr().err
    assert "rooms.json is damaged" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "preview.png").exists()


@pytest.mark.parametrize("name", ["missing/sheet.png", "sheet.gif"])
def test_a_preview_that_cannot_be_written_is_refused(tmp_path, capsys, monkeypatch, name):
    monkeypatch.setattr(generate, "render_scene", lambda seed, *rest: None)
    assert rooms(tmp_path / "rooms", "--seeds", "0:16", "--workers", "1") == OK
    capsys.readouterr()
    output = tmp_path / name
    assert main(["data", "preview", str(tmp_path / "rooms"), "-o", str(output)]) == BAD_INPUT
    assert f"cannot write {output}" in capsys.readouterr().err
