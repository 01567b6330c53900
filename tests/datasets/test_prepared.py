import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from instok3d.data.scenes import SceneSource
from instok3d.datasets.prepared import (
    DroppedFrame,
    PreparedScenes,
    SceneInfo,
    read_index,
    read_scene,
    refresh_index,
    verify,
    write_scene,
)
from instok3d.files import sha256_of
from kill_points import die_in
from prepared_scenes import made_folder, made_frame

INFO = SceneInfo("scene0000_00", "scannet", "train", "metre", {"size": [6, 8]})


def faults(folder: Path) -> dict[str, str]:
    return {fault.path: fault.problem for fault in verify(folder)}


def test_what_was_written_is_read_back_exactly(tmp_path: Path):
    layers = ("depths", "instances", "labels")
    frames = [made_frame(number, layers=layers) for number in range(3)]
    write_scene(tmp_path, INFO, [frames[0], DroppedFrame("5", "no pose"), *frames[1:]])
    refresh_index(tmp_path)
    source = PreparedScenes(tmp_path)
    assert isinstance(source, SceneSource)
    assert (len(source), source.name_of(0), source.num_frames(0)) == (1, "scene0000_00", 3)
    read = source.frames(0, [2, 0])
    chosen = [frames[2], frames[0]]
    np.testing.assert_array_equal(read.images, np.stack([f.image for f in chosen]))
    np.testing.assert_array_equal(read.world_from_cam, np.stack([f.world_from_cam for f in chosen]))
    np.testing.assert_array_equal(read.intrinsics, np.stack([f.intrinsics for f in chosen]))
    for k, frame in enumerate(chosen):
        assert frame.depth_thousandths is not None
        np.testing.assert_array_equal(read.instances[k], frame.instances)
        np.testing.assert_allclose(read.depths_m[k], frame.depth_thousandths / 1000, rtol=1e-6)
    labels = source.labels(0, [1])
    assert labels is not None
    np.testing.assert_array_equal(labels[0], frames[1].labels)
    record = read_scene(tmp_path / "scene0000_00")
    assert record.info == INFO
    assert (record.sources, record.dropped) == (("0", "10", "20"), {"no pose": 1})


def test_unknown_ids_are_ignored_and_unknown_depth_is_zero(tmp_path: Path):
    write_scene(tmp_path, INFO, [made_frame(0, layers=())])
    refresh_index(tmp_path)
    source = PreparedScenes(tmp_path)
    read = source.frames(0, [0])
    assert (read.instances == -1).all()
    assert (read.depths_m == 0).all()
    assert source.labels(0, [0]) is None


def test_no_chosen_frames_give_empty_tensors(tmp_path: Path):
    source = PreparedScenes(made_folder(tmp_path, {"a": "train"}))
    read = source.frames(0, [])
    assert (read.images.shape, read.images.dtype) == (torch.Size([0, 6, 8, 3]), torch.uint8)
    assert read.instances.shape == read.depths_m.shape == (0, 6, 8)


def test_only_the_wanted_splits_are_kept_in_order_of_name(tmp_path: Path):
    made_folder(tmp_path, {"c": "train", "a": "train", "b": "val"})
    train = PreparedScenes(tmp_path)
    assert [train.name_of(k) for k in range(len(train))] == ["a", "c"]
    assert len(PreparedScenes(tmp_path, splits=("train", "val"))) == 3
    with pytest.raises(ValueError, match="none of them of the splits test"):
        PreparedScenes(tmp_path, splits=("test",))


def write_masks_record(masks: Path) -> None:
    files = {path.name: [path.stat().st_size, sha256_of(path)] for path in masks.glob("*.png")}
    record = {"format": "instok3d-masks-1", "statistics": {}, "files": files}
    (masks / "masks.json").write_text(json.dumps(record))


def test_masks_of_a_model_take_the_place_of_the_ids(tmp_path: Path):
    folder = made_folder(tmp_path, {"a": "train"})
    with pytest.raises(FileNotFoundError, match="have no masks of sam2"):
        PreparedScenes(folder, masks="sam2")
    (folder / "a" / "instances").rename(folder / "a" / "masks_sam2")
    write_masks_record(folder / "a" / "masks_sam2")
    read = PreparedScenes(folder, masks="sam2").frames(0, [3])
    np.testing.assert_array_equal(read.instances[0], made_frame(3).instances)


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([], "has no usable frame"),
        ([DroppedFrame("0", "no pose")] * 2, "dropped: 2 with no pose"),
        ([made_frame(0), made_frame(1, (8, 6))], "frame 10 of scene .* must agree in height"),
        ([made_frame(0), made_frame(1, layers=("depths",))], "kinds of pictures"),
        (
            [replace(made_frame(0), intrinsics=np.full((3, 3), np.nan))],
            "that are not finite",
        ),
    ],
)
def test_a_scene_that_cannot_be_written_leaves_nothing(tmp_path: Path, frames: list, message: str):
    with pytest.raises(ValueError, match=message):
        write_scene(tmp_path, INFO, frames)
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_scene_leaves_nothing(tmp_path: Path):
    def frames():
        yield made_frame(0)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_scene(tmp_path, INFO, frames())
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_run_left_is_replaced(tmp_path: Path):
    die_in(tmp_path / INFO.name)
    (left,) = tmp_path.iterdir()
    assert faults(tmp_path)[left.name].startswith("was left by a run")
    write_scene(tmp_path, INFO, [made_frame(0)])
    refresh_index(tmp_path)
    assert faults(tmp_path) == {}


def test_a_scene_is_never_overwritten(tmp_path: Path):
    write_scene(tmp_path, INFO, [made_frame(0)])
    with pytest.raises(FileExistsError, match="delete it to prepare the scene again"):
        write_scene(tmp_path, INFO, [made_frame(1)])


@pytest.mark.parametrize("name", ["", ".hidden", "a/b"])
def test_a_name_that_is_no_folder_is_refused(name: str):
    with pytest.raises(ValueError, match="cannot be the name"):
        SceneInfo(name, "scannet", "train", "metre")


def test_the_index_follows_the_folders(tmp_path: Path):
    made_folder(tmp_path, {"a": "train", "b": "test"})
    index = (tmp_path / "scenes.json").read_bytes()
    (tmp_path / "scenes.json").unlink()
    refresh_index(tmp_path)
    assert (tmp_path / "scenes.json").read_bytes() == index
    assert read_index(tmp_path)["b"]["split"] == "test"
    for path in sorted((tmp_path / "b").rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    (tmp_path / "b").rmdir()
    assert list(refresh_index(tmp_path)["scenes"]) == ["a"]


def damage_record(folder: Path) -> None:
    record = json.loads((folder / "a" / "scene.json").read_text())
    record["frames"][0]["world_from_cam"][0][0] = None
    (folder / "a" / "scene.json").write_text(json.dumps(record))


def flip_byte(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[-20] ^= 1
    path.write_bytes(data)


DAMAGES: list[tuple[Callable[[Path], object], str, str]] = [
    (lambda f: (f / "a/images/000001.png").unlink(), "a/images/000001.png", "is missing"),
    (lambda f: flip_byte(f / "a/depths/000002.png"), "a/depths/000002.png", "checksum differs"),
    (
        lambda f: (f / "a/instances/000000.png").write_bytes(b"short"),
        "a/instances/000000.png",
        "has 5 bytes, should have",
    ),
    (lambda f: (f / "a/images/extra.png").write_bytes(b"x"), "a/images/extra.png", "not listed"),
    (damage_record, "a/scene.json", "is damaged"),
    (lambda f: (f / "a/scene.json").unlink(), "a", "folder without scene.json"),
    (lambda f: (f / "scenes.json").write_text("{"), "scenes.json", "is damaged"),
    (lambda f: (f / "scenes.json").unlink(), "scenes.json", "there is no scenes.json"),
    (lambda f: (f / "a").rename(f / "z"), "z", "is not in the index"),
    (lambda f: (f / "a").rename(f / "z"), "a", "in the index but not in the folder"),
    (lambda f: (f / "a").rename(f / "z"), "z/scene.json", "belongs to the scene a"),
]


@pytest.mark.parametrize(("damage", "path", "problem"), DAMAGES)
def test_each_damage_is_found_at_its_file(
    tmp_path: Path, damage: Callable[[Path], object], path: str, problem: str
):
    folder = made_folder(tmp_path, {"a": "train", "b": "train"}, num_frames=3)
    assert faults(folder) == {}
    damage(folder)
    assert any(fault.path == path and problem in fault.problem for fault in verify(folder))


def test_masks_are_verified_by_their_own_record(tmp_path: Path):
    folder = made_folder(tmp_path, {"a": "train"}, num_frames=1)
    masks = folder / "a" / "masks_sam2"
    masks.mkdir()
    (masks / "000000.png").write_bytes((folder / "a/instances/000000.png").read_bytes())
    write_masks_record(masks)
    assert faults(folder) == {}
    flip_byte(masks / "000000.png")
    assert list(faults(folder)) == ["a/masks_sam2/000000.png"]
    (masks / "masks.json").write_text("{}")
    assert "is damaged" in faults(folder)["a/masks_sam2/masks.json"]


def test_a_damaged_picture_is_named_when_it_is_read(tmp_path: Path):
    source = PreparedScenes(made_folder(tmp_path, {"a": "train"}))
    (tmp_path / "a/images/000001.png").write_bytes(b"no picture")
    assert source.frames(0, [0]).images.shape == (1, 6, 8, 3)
    with pytest.raises(ValueError, match=r"images/000001\.png is damaged"):
        source.frames(0, [1])
    with pytest.raises(IndexError, match=r"has 5 frames, asked for \[5\]"):
        source.frames(0, [0, 5])


def test_an_empty_folder_says_how_to_fill_it(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match="instok3d data prepare"):
        PreparedScenes(tmp_path)
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        list(verify(tmp_path / "none"))


def test_scenes_without_cameras_are_written_and_verified_but_not_read_for_training(tmp_path: Path):
    frames = [replace(made_frame(k), world_from_cam=None, intrinsics=None) for k in range(2)]
    record = write_scene(tmp_path, INFO, frames)
    assert record.world_from_cam is None
    assert record.intrinsics is None
    written = json.loads((tmp_path / "scene0000_00/scene.json").read_text())
    assert written["frames"][1] == {"source": "10", "world_from_cam": None, "intrinsics": None}
    refresh_index(tmp_path)
    assert not faults(tmp_path)
    with pytest.raises(ValueError, match=r"1 scenes in .* have no cameras, such as scene0000_00"):
        PreparedScenes(tmp_path)


def test_a_scene_has_cameras_in_all_frames_or_in_none(tmp_path: Path):
    blind = replace(made_frame(1), world_from_cam=None, intrinsics=None)
    with pytest.raises(ValueError, match=r"frame 10 of scene scene0000_00 has .*'no cameras'"):
        write_scene(tmp_path, INFO, [made_frame(0), blind])
    assert list(tmp_path.iterdir()) == []
