"""`instok3d data masks` with a tiny random SAM 2: folders, figures, exit codes."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from instok3d.cli import BAD_INPUT, MISSING_WEIGHTS, OK, main
from prepared_scenes import made_folder
from tiny_sam2 import write_tiny_sam2

needs_transformers = pytest.mark.skipif(
    not __import__("importlib.util").util.find_spec("transformers"),
    reason="SAM 2 needs transformers: pip install instok3d[models]",
)


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny_sam2(tmp_path_factory.mktemp("weights"))


def masks(*words: object) -> int:
    return main(["data", "masks", *map(str, words), "--points-per-side", "2"])


@needs_transformers
@pytest.mark.filterwarnings("ignore:no mask was found")
def test_scenes_are_labelled_resumed_and_reported(tmp_path, weights, capsys):
    folder = made_folder(tmp_path, {"a": "train", "b": "test"}, num_frames=3)
    assert masks(folder, "--weights", weights, "--scenes", "b") == OK
    assert "1 clips labelled, 0 there already, 0 failed" in capsys.readouterr().out
    assert not (folder / "a" / "masks_sam2").exists()

    assert masks(folder, "--weights", weights, "--json") == OK
    shown = json.loads(capsys.readouterr().out)
    assert {name: each["outcome"] for name, each in shown["clips"].items()} == {
        "a": "made", "b": "there already"
    }  # fmt: skip
    assert shown["clips"]["a"]["frames"] == 3
    assert shown["failed"] == {}
    assert main(["data", "verify", str(folder)]) == OK


@needs_transformers
@pytest.mark.filterwarnings("ignore:no mask was found")
def test_damaged_scenes_do_not_stop_the_others(tmp_path, weights, capsys):
    folder = made_folder(tmp_path, {"a": "train", "b": "train", "c": "train"}, num_frames=2)
    (folder / "a" / "images" / "000001.png").write_bytes(b"")
    (folder / "c" / "scene.json").write_text("{")
    assert masks(folder, "--weights", weights) == BAD_INPUT
    shown = capsys.readouterr()
    assert "1 clips labelled, 0 there already, 2 failed" in shown.out
    assert "c/scene.json is damaged" in shown.err
    assert "000001.png cannot be read as a picture" in shown.err
    assert (folder / "b" / "masks_sam2" / "masks.json").is_file()


@needs_transformers
@pytest.mark.filterwarnings("ignore:no mask was found")
def test_pictures_of_ones_own_get_id_maps(tmp_path, weights):
    rng = np.random.default_rng(0)
    (tmp_path / "clip").mkdir()
    for name in ("1.png", "2.png", "10.png"):
        pixels = rng.integers(0, 256, (12, 16, 3)).astype(np.uint8)
        Image.fromarray(pixels).save(tmp_path / "clip" / name)
    assert masks(tmp_path / "clip", "--weights", weights, "-o", tmp_path / "ids") == OK
    record = json.loads((tmp_path / "ids" / "masks.json").read_text())
    assert list(record["files"]) == ["1.png", "2.png", "10.png"]  # in the order of the clip


def test_without_weights_the_exit_code_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("INSTOK3D_HOME", str(tmp_path / "home"))
    folder = made_folder(tmp_path / "prepared", {"a": "train"}, num_frames=1)
    assert masks(folder, "--size", "tiny") == MISSING_WEIGHTS
    assert "instok3d models pull sam2.1-tiny" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["nowhere"], "there is no folder nowhere"),
        (["clip"], "for a folder of pictures pass -o"),
        (["clip", "-o", "x", "--scenes", "a"], "--scenes chooses from a prepared folder"),
        (["prepared", "-o", "x"], "its masks go into it, -o is for a folder of pictures"),
        (["prepared", "--scenes", "z"], "prepared has no scene z; it has a"),
    ],
)
def test_wrong_folders_are_refused(words, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    made_folder(Path("prepared"), {"a": "train"}, num_frames=1)
    Path("clip").mkdir()
    Image.new("RGB", (4, 4)).save("clip/a.png")
    assert masks(*words) == BAD_INPUT
    assert says in capsys.readouterr().err
