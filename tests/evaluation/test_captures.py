import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from capture_folders import write_capture, write_outlines
from colmap_models import write_colmap
from flat_rooms import SIZE, flat_room
from instok3d.evaluation.captures import (
    capture_choices,
    capture_scenes,
    find_captures,
    read_capture,
)
from instok3d.evaluation.outlines import read_outlines


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    return write_capture(tmp_path_factory.mktemp("captures") / "room", 11)


def test_frames_come_in_natural_order_as_they_were_taken(capture):
    room = flat_room()
    source = read_capture(capture, side=32)
    assert (source.name_of(0), source.num_frames(0), len(source)) == ("room", 11, 1)
    frames = source.frames(0, [2, 10])
    np.testing.assert_array_equal(frames.images, room.images[[2, 10]])
    np.testing.assert_allclose(frames.depths_m, room.depths_m[[2, 10]], atol=6e-4)
    np.testing.assert_allclose(frames.world_from_cam, room.world_from_cam[[2, 10]], atol=1e-9)
    np.testing.assert_allclose(frames.intrinsics, room.intrinsics[[2, 10]])
    assert (frames.instances == -1).all()


def test_outlines_are_found_by_the_hash_of_the_photo_and_follow_its_size(capture, tmp_path):
    square = [[8, 8], [24, 8], [24, 16], [8, 16]]
    write_outlines(tmp_path, capture / "color/3.png", {"wall": square})
    source = read_capture(capture, side=16, outlines=read_outlines(tmp_path))
    frames = source.frames(0, [2, 3])
    expected = np.zeros((16, 16), int)
    expected[4:8, 4:12] = 1
    assert (frames.instances[0] == -1).all()
    np.testing.assert_array_equal(frames.instances[1], expected)


def test_outlines_of_another_size_are_refused(capture, tmp_path):
    path = write_outlines(tmp_path, capture / "color/3.png", {})
    path.write_text(path.read_text().replace('"height": 32', '"height": 30'))
    source = read_capture(capture, side=16, outlines=read_outlines(tmp_path))
    with pytest.raises(ValueError, match=r"32 x 30 pixels, its photo 32 x 32"):
        source.frames(0, [3])


def test_frame_step_takes_every_so_many_frames(capture):
    source = read_capture(capture, side=32, frame_step=5)
    np.testing.assert_array_equal(source.frames(0, [1]).images[0], flat_room().images[5])
    assert source.num_frames(0) == 3


def test_two_view_targets_are_all_frames_with_two_neighbours():
    choices = capture_choices("capture-2view", 5)
    assert [(each.context, each.target) for each in choices] == [
        ((0, 2), (1,)), ((1, 3), (2,)), ((2, 4), (3,))
    ]  # fmt: skip
    some = capture_choices("capture-2view", 64, targets_per_scene=2)
    assert [each.target for each in some] == [(16,), (47,)]


def test_eight_view_windows_follow_each_other():
    first, second = capture_choices("capture-8view", 44)
    assert first.context == (0, 2, 4, 6, 8, 10, 12, 14)
    assert second.target == (16, 18, 20, 22, 24, 26, 28)
    assert len(capture_choices("capture-8view", 64)) == 4
    assert len(capture_choices("capture-8view", 64, targets_per_scene=8)) == 2


@pytest.mark.parametrize(("protocol", "count"), [("capture-2view", 2), ("capture-8view", 14)])
def test_too_few_frames_are_told_with_the_number_that_is_needed(protocol, count):
    with pytest.raises(ValueError, match=f"it has {count} frames, {protocol} needs {count + 1}"):
        capture_choices(protocol, count)


def test_samples_are_in_metres_or_in_baselines_where_no_unit_is_known(capture, tmp_path):
    metric = read_capture(capture, side=32)
    arbitrary = read_capture(write_capture(tmp_path / "a", 3, depth=False), side=32)
    first, second = capture_scenes([metric, arbitrary], "capture-2view")
    assert (first.unit, second.unit) == ("metre", "baseline")
    assert len(first.samples) == 9
    (sample,) = second.samples
    assert sample.context.depths is not None
    assert not sample.context.depths.any()
    assert sample.context.cam_from_world is not None
    assert sample.context.cam_from_world[0, 1, :3, 3].norm() == pytest.approx(1)


def test_a_colmap_folder_is_a_capture(capture, tmp_path):
    room = flat_room()
    shutil.copytree(capture / "color", tmp_path / "images")
    images = [
        (f"{number}.png", torch.from_numpy(room.world_from_cam[number]).inverse(), 1)
        for number in range(11)
    ]
    focal, half = room.intrinsics[0, 0, 0], SIZE / 2
    cameras = {1: ("PINHOLE", SIZE, SIZE, (focal, focal, half, half))}
    write_colmap(tmp_path / "sparse/0", cameras, images, ".bin")
    (folder,) = find_captures(tmp_path)
    source = read_capture(folder, side=32)
    assert not source.metric
    frames = source.frames(0, [3, 10])
    np.testing.assert_array_equal(frames.images, room.images[[3, 10]])
    np.testing.assert_allclose(frames.world_from_cam, room.world_from_cam[[3, 10]], atol=1e-6)


def test_a_capture_that_cannot_be_read_is_left_out_by_name_beside_others(capture, tmp_path):
    broken = write_capture(tmp_path / "broken", 3)
    (broken / "color/1.png").write_bytes(b"no picture")
    captures = [read_capture(folder, side=32) for folder in (broken, capture)]
    with pytest.warns(UserWarning, match=r"capture broken is left out: .*1\.png"):
        assert [scene.name for scene in capture_scenes(captures, "capture-2view")] == ["room"]
    with pytest.raises(ValueError, match=r"1\.png"):
        list(capture_scenes(captures, "capture-2view", strict=True))


def test_depth_in_another_unit_than_the_cameras_is_refused(tmp_path):
    folder = write_capture(tmp_path / "room", 5)
    value = json.loads((folder / "scene.json").read_text())
    (folder / "scene.json").write_text(json.dumps({**value, "depth_scale": 5}))
    with pytest.raises(ValueError, match="depth"):
        read_capture(folder, side=32)


def test_captures_are_found_in_a_folder_or_it_is_one_itself(capture, tmp_path):
    assert find_captures(capture) == [capture]
    for name in ("c10", "c9"):
        write_capture(tmp_path / name, 3)
    (tmp_path / "notes").mkdir()
    with pytest.warns(UserWarning, match=r"1 of 3 folders .* hold no cameras .*: notes"):
        assert [path.name for path in find_captures(tmp_path)] == ["c9", "c10"]


def test_a_folder_without_a_capture_says_what_is_wanted(tmp_path):
    Image.new("RGB", (8, 8)).save(tmp_path / "a.png")
    with pytest.raises(FileNotFoundError, match=r"holds no capture: .* scene\.json"):
        find_captures(tmp_path)
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        find_captures(tmp_path / "nowhere")


def test_the_kitchen_gives_all_its_targets(shared):
    folder = shared / "data" / "rgbd_posed" / "sevenscenes_redkitchen"
    if not folder.is_dir():
        pytest.skip(f"the capture is not here: no folder {folder}")
    source = read_capture(folder, side=32, outlines=read_outlines())
    assert len(capture_choices("capture-2view", source.num_frames(0))) == 62
    ids = source.frames(0, [1, 2]).instances
    assert (ids[0] >= 0).all()
    assert (ids[1] == -1).all()
