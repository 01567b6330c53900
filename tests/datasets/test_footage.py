import json
import os
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from depth_room import HEIGHT, INTRINSICS, WIDTH, room
from instok3d.datasets.footage import FootageSource
from instok3d.datasets.preparation import PreparationReport, plan_preparation, prepare
from instok3d.datasets.prepared import PreparedScenes, read_scene, verify
from instok3d.geometry.cameras import invert_rigid, project, transform_points, unproject


def write_photos(folder: Path, count: int, size: tuple[int, int] = (40, 30)) -> Path:
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    for number in range(count):
        pixels = rng.integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)
        Image.fromarray(pixels).save(folder / f"shot {number}.jpg", quality=95)
    return folder


def write_ids(folder: Path, count: int, size: tuple[int, int] = (40, 30)) -> Path:
    folder.mkdir(parents=True)
    for number in range(count):
        ids = np.zeros((size[1], size[0]), dtype=np.uint16)
        ids[:, size[0] // 2 :] = 300 + number
        Image.fromarray(ids).save(folder / f"shot {number}.png")
    return folder


def write_transforms(path: Path, count: int) -> Path:
    frames = []
    for number in range(count):
        matrix = np.eye(4)
        matrix[0, 3] = number
        frames.append({"file_path": f"shot {number}.jpg", "transform_matrix": matrix.tolist()})
    path.write_text(json.dumps({"w": 40, "h": 30, "fl_x": 35.0, "frames": frames}))
    return path


def prepared(source: FootageSource, output: Path) -> PreparationReport:
    return prepare(plan_preparation(source.jobs(), output), workers=1, progress=False)


def test_photos_with_ids_become_a_scene_without_cameras(tmp_path):
    photos, masks = write_photos(tmp_path / "kitchen", 11), write_ids(tmp_path / "masks", 11)
    report = prepared(FootageSource(photos, masks, size=16), tmp_path / "out")
    assert (report.scenes, report.frames, report.failed) == (1, 11, {})
    assert not list(verify(tmp_path / "out"))
    scene = read_scene(tmp_path / "out/kitchen")
    assert scene.info.dataset == "footage"
    assert scene.world_from_cam is None
    assert scene.sources[2] == "shot 2.jpg"
    assert scene.sources[10] == "shot 10.jpg"  # in natural order
    ids = np.asarray(Image.open(tmp_path / "out/kitchen/instances/000010.png"))
    assert ids.shape == (16, 16)
    assert (ids[:, :8] == 0).all()
    assert (ids[:, 8:] == 310).all()
    with pytest.raises(ValueError, match=r"1 scenes in .*have no cameras, such as kitchen"):
        PreparedScenes(tmp_path / "out")


def test_photos_with_ids_and_cameras_can_be_trained_on(tmp_path):
    photos, masks = write_photos(tmp_path / "kitchen", 3), write_ids(tmp_path / "masks", 3)
    cameras = write_transforms(tmp_path / "transforms.json", 3)
    source = FootageSource(photos, masks, cameras, name="flat", size=16, split="val")
    (job,) = pickle.loads(pickle.dumps(source.jobs()))  # as it goes to another process
    assert len(list(job.frames())) == 3
    assert prepared(source, tmp_path / "out").failed == {}
    frames = PreparedScenes(tmp_path / "out", splits=("val",)).frames(0, [0, 2])
    assert frames.name == "flat"
    assert (frames.instances[1, :, 8:] == 302).all()
    assert frames.world_from_cam[1, :3, 3].tolist() == pytest.approx([2.0, 0.0, 0.0])
    # 30 rows become 16: f = 35 * 16 / 30.
    assert frames.intrinsics[0, 0, 0].item() == pytest.approx(35 * 16 / 30)


def test_scenes_are_named_by_the_whole_name_of_their_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("room.v1", "room.v2", "~room"):
        write_photos(tmp_path / name, 1)
        (job,) = FootageSource(Path(name), size=16).jobs()
        assert job.info.name == name


def test_a_pipe_among_the_id_maps_is_none_of_them(tmp_path):
    photos, masks = write_photos(tmp_path / "kitchen", 2), write_ids(tmp_path / "masks", 1)
    os.mkfifo(masks / "shot 1.png")
    with pytest.raises(FileNotFoundError, match=r"no id map for 1 of 2 photos"):
        FootageSource(photos, masks).jobs()


def test_photos_beside_a_capture_that_have_no_camera_are_told(tmp_path):
    photos = write_photos(tmp_path / "room/images", 4)
    table = json.loads(write_transforms(tmp_path / "transforms.json", 2).read_text())
    (photos.parent / "transforms.json").write_text(json.dumps(table))
    with pytest.warns(UserWarning, match=r"2 of 4 photos .*left out: images/shot 2\.jpg"):
        (job,) = FootageSource(photos.parent, size=16).jobs()
    assert len(list(job.frames())) == 2


def test_bad_footage_is_refused_with_a_reason(tmp_path):
    photos = write_photos(tmp_path / "kitchen", 3)
    with pytest.raises(FileNotFoundError, match="no file or folder"):
        FootageSource(tmp_path / "nowhere").jobs()
    with pytest.raises(FileNotFoundError, match="no folder of id maps"):
        FootageSource(photos, tmp_path / "masks").jobs()
    masks = write_ids(tmp_path / "masks", 2)
    with pytest.raises(FileNotFoundError, match=r"for 1 of 3 photos, such as shot 2\.jpg \(wanted"):
        FootageSource(photos, masks).jobs()
    with pytest.raises(ValueError, match="no camera for 1 of 3 photos"):
        FootageSource(photos, cameras=write_transforms(tmp_path / "cameras.json", 2)).jobs()
    more = write_ids(tmp_path / "more", 4)
    with pytest.warns(UserWarning, match="1 of 4 id maps .* belong to no photo"):
        FootageSource(photos, more).jobs()
    small = write_ids(tmp_path / "small", 3, (20, 15))
    report = prepared(FootageSource(photos, small, size=16), tmp_path / "out")
    assert "has 20 x 15 pixels, its photo 40 x 30" in report.failed["kitchen"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"scenes.json"}
    (photos / "shot 1.jpg").write_bytes(b"\xff\xd8\xff\xe0 cut")
    report = prepared(FootageSource(photos, size=16), tmp_path / "out")
    assert "shot 1.jpg" in report.failed["kitchen"]


def test_depth_in_an_unknown_unit_is_left_out_with_a_warning(tmp_path):
    photos = write_photos(tmp_path / "kitchen", 1)
    data = json.loads(write_transforms(tmp_path / "transforms.json", 1).read_text())
    data["frames"][0]["depth_file_path"] = "depth.png"
    (tmp_path / "transforms.json").write_text(json.dumps(data))
    with pytest.warns(UserWarning, match="left out: its unit is not known"):
        (job,) = FootageSource(photos, cameras=tmp_path / "transforms.json").jobs()
    assert job.info.settings["layers"] == ["images"]


def write_rgbd(folder: Path, store, **table) -> Path:
    """A recording of a box room; `store` brings its metres into what the files hold."""
    depths, cam_from_world = room(3)
    frames = []
    for index, pose in enumerate(invert_rigid(cam_from_world)):
        (folder / "color").mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (WIDTH, HEIGHT)).save(folder / f"color/{index}.png")
        np.save(folder / f"{index}.npy", store(depths[index].numpy()))
        frames.append(
            {"color": f"color/{index}.png", "depth": f"{index}.npy", "c2w": pose.tolist()}
        )
    sizes = {"width": WIDTH, "height": HEIGHT, "K": INTRINSICS.tolist()}
    (folder / "scene.json").write_text(json.dumps({**sizes, "frames": frames, **table}))
    return folder


def test_depth_in_metres_is_prepared_in_thousandths(tmp_path):
    folder = write_rgbd(tmp_path / "room", lambda d: d.astype(np.float32), depth_scale=1)
    assert prepared(FootageSource(folder, size=32), tmp_path / "out").failed == {}
    depths = PreparedScenes(tmp_path / "out").frames(0, [0, 2]).depths_m
    assert 1 < float(depths.median()) < 5


@pytest.mark.parametrize(
    ("store", "table", "message"),
    [
        (lambda d: d.astype(np.float32), {}, "m in the median, which is no room"),
        (lambda d: (1000 * d).astype(np.uint16), {"depth_scale": 1}, "which is no room"),
        (lambda d: (1000 * d).astype(np.uint16), {"depth_scale": 5000}, "does not fit the cameras"),
        (lambda d: (1000 * d).astype(np.uint16).byteswap(), {}, "looks byte-swapped"),
        (lambda d: np.full(d.shape, 65534, np.uint16), {}, "65.534 in every pixel"),
        (lambda d: np.zeros(d.shape, np.uint16), {}, "hold no depth"),
        (lambda d: np.full(d.shape, np.nan, np.float32), {}, "hold no depth"),
    ],
)
def test_depth_that_does_not_fit_is_refused_before_a_frame_is_written(
    tmp_path, store, table, message
):
    folder = write_rgbd(tmp_path / "room", store, **table)
    report = prepared(FootageSource(folder, size=32), tmp_path / "out")
    assert message in report.failed["room"]
    assert not (tmp_path / "out/room").exists()


def test_real_posed_depth_of_two_frames_agrees(shared, tmp_path):
    # Two frames of 7-Scenes, five apart; colour and depth of its Kinect are not registered, so
    # the depths are compared: those of one frame, moved into the other, against that one's own.
    original = shared / "data/rgbd_posed/sevenscenes_redkitchen"
    data = json.loads((original / "scene.json").read_text())
    data["frames"] = data["frames"][:2]
    for frame in data["frames"]:
        frame["color"], frame["depth"] = (str(original / frame[key]) for key in ("color", "depth"))
    (tmp_path / "scene.json").write_text(json.dumps(data))
    with pytest.raises(ValueError, match=r"lies outside of the folder .* --allow-outside"):
        FootageSource(tmp_path / "scene.json", name="redkitchen", size=64).jobs()
    source = FootageSource(tmp_path / "scene.json", name="redkitchen", size=64, allow_outside=True)
    assert prepared(source, tmp_path / "out").failed == {}
    scene = PreparedScenes(tmp_path / "out").frames(0, [0, 1])
    assert read_scene(tmp_path / "out/redkitchen").info.unit == "metre"
    points = unproject(scene.depths_m[0].double(), scene.intrinsics[0])
    known = scene.depths_m[0] > 0
    assert known.float().mean() > 0.7
    second_from_first = invert_rigid(scene.world_from_cam[1]) @ scene.world_from_cam[0]
    moved = transform_points(second_from_first, points[known])
    pixels = project(moved, scene.intrinsics[1]).floor().long()
    inside = ((pixels >= 0) & (pixels < 64)).all(dim=1)
    there = scene.depths_m[1][pixels[inside, 1], pixels[inside, 0]]
    error = (there - moved[inside, 2])[there > 0].abs()
    assert torch.median(error) < 0.03
    assert inside.float().mean() > 0.7


def test_other_footage_of_the_same_name_is_refused_instead_of_skipped(tmp_path):
    kitchen = FootageSource(write_photos(tmp_path / "kitchen/images", 3), size=16)
    prepared(kitchen, tmp_path / "out")
    assert plan_preparation(kitchen.jobs(), tmp_path / "out").jobs == ()
    bedroom = write_photos(tmp_path / "bedroom/images", 3, (48, 30))
    with pytest.raises(ValueError, match=r"scene images with settings\.origin '3 files"):
        plan_preparation(FootageSource(bedroom, size=16).jobs(), tmp_path / "out")
    named = FootageSource(bedroom, name="bedroom", size=16)
    assert prepared(named, tmp_path / "out").scenes == 1


def test_the_same_photos_with_other_cameras_or_ids_are_another_scene(tmp_path):
    photos, masks = write_photos(tmp_path / "kitchen", 2), write_ids(tmp_path / "masks", 2)
    cameras = write_transforms(tmp_path / "transforms.json", 2)
    source = FootageSource(photos, masks, cameras)
    (before,) = source.jobs()
    cameras.write_text(cameras.read_text().replace('"fl_x": 35.0', '"fl_x": 36.0'))
    (turned,) = source.jobs()
    Image.fromarray(np.arange(1200, dtype=np.uint16).reshape(30, 40)).save(masks / "shot 0.png")
    (relabelled,) = source.jobs()
    assert len({str(job.info.settings) for job in (before, turned, relabelled)}) == 3
