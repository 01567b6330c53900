"""A damaged prepared folder is read, or refused in one line; so is one of impossible cameras."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from instok3d.datasets.prepared import PreparedScenes, read_index, read_scene
from instok3d.datasets.prepared.format import can_name_a_scene
from instok3d.datasets.prepared.masks import read_masks_record
from mutations import limits, of_bytes, of_json, survive
from prepared_scenes import made_folder

LAYERS = ("images", "depths", "instances")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return made_folder(tmp_path, {"a": "train"}, num_frames=2)


def test_a_record(folder: Path):
    assert survive(folder / "a" / "scene.json", lambda: read_scene(folder / "a"), of_json, 200)


def test_an_index(folder: Path):
    assert survive(folder / "scenes.json", lambda: read_index(folder), of_json, 150)


@pytest.mark.parametrize("layer", LAYERS)
def test_a_picture(folder: Path, layer: str):
    source = PreparedScenes(folder)
    file = folder / "a" / layer / "000001.png"
    assert survive(file, lambda: source.frames(0, [1]), of_bytes, 50)


def test_a_record_of_masks(tmp_path: Path):
    file = tmp_path / "masks.json"
    record = {"format": "instok3d-masks-1", "model": "sam2", "config": {"a": 1},
              "statistics": {"tracks": 3}, "files": {"000000.png": [10, "0" * 64]}}  # fmt: skip
    file.write_text(json.dumps(record))
    assert survive(file, lambda: read_masks_record(tmp_path), of_json, 100)


def changed(change: Callable[[dict], object]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        file = folder / "a" / "scene.json"
        record = json.loads(file.read_text())
        change(record)
        file.write_text(json.dumps(record))

    return apply


def camera(key: str, row: int, column: int, value: float) -> Callable[[Path], None]:
    return changed(lambda r: r["frames"][1][key][row].__setitem__(column, value))


DAMAGE = {
    "are too large": changed(lambda r: r.update(height=10**9)),
    "'6' is no whole number": changed(lambda r: r.update(height="6")),
    "frame 1 has a pose whose rotation is not": camera("world_from_cam", 0, 0, 2.0),
    "frame 1 stands 1e.30 units": camera("world_from_cam", 0, 3, 1e30),
    "frame 1 has the focal length -7": camera("intrinsics", 0, 0, -7.0),
    "frame 1 has intrinsics with 2 below": camera("intrinsics", 1, 0, 2.0),
    "frame 1 has a pose that is not 4 x 4": changed(
        lambda r: r["frames"][1].update(world_from_cam=None)
    ),
    "its files are not one for each of its 2 frames": changed(
        lambda r: r["files"].update({"../x": [1, ""]})
    ),
    "files are not one for each of its 1 frames": changed(lambda r: r["frames"].pop()),
    "'moon' is none of": changed(lambda r: r.update(dataset="moon")),
    "'../a' cannot be the name": changed(lambda r: r.update(name="../a")),
}


@pytest.mark.parametrize("reason", DAMAGE)
def test_a_scene_that_cannot_be_is_refused_with_the_reason(folder: Path, reason: str):
    DAMAGE[reason](folder)
    with pytest.raises(ValueError, match=rf"a/scene\.json is damaged \(.*{reason}"):
        read_scene(folder / "a")


def test_an_index_of_another_number_of_frames_is_told(folder: Path):
    index = json.loads((folder / "scenes.json").read_text())
    index["scenes"]["a"]["num_frames"] = 5
    (folder / "scenes.json").write_text(json.dumps(index))
    with pytest.raises(ValueError, match=r"a has 2 frames, the index .* says 5; run"):
        PreparedScenes(folder).frames(0, [4])


def test_a_picture_that_would_fill_the_memory_is_refused_by_its_header(folder: Path):
    Image.fromarray(np.zeros((8000, 10_000), np.uint8)).save(folder / "a/images/000001.png")
    with pytest.raises(ValueError, match=r"000001\.png has the size \(10000, 8000\), its"):
        PreparedScenes(folder).frames(0, [1])


def test_a_chunk_that_promises_four_gigabytes_takes_no_memory(folder: Path):
    file = folder / "a" / "images" / "000001.png"
    data = bytearray(file.read_bytes())
    at = data.index(b"IDAT") - 4
    data[at : at + 4] = (2**32 - 1).to_bytes(4, "big")
    file.write_bytes(data)
    with limits():  # all of it is there
        assert PreparedScenes(folder).frames(0, [1]).images.shape == (1, 6, 8, 3)


def test_names_of_scenes_are_those_of_folders():
    assert all(map(can_name_a_scene, ["a", "a b", "\u5c45", "x" * 200]))
    assert not any(map(can_name_a_scene, ["", ".a", "..", "a/b", "a\\b", "a\n", "\0", "x" * 201]))
