import os
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from colmap_models import write_colmap
from instok3d.datasets.colmap_scenes import ColmapSource, MipNeRF360Source
from instok3d.datasets.preparation import PreparationReport, plan_preparation, prepare
from instok3d.datasets.prepared import PreparedScenes, read_scene, verify
from instok3d.geometry.cameras import invert_rigid

PINHOLE = {1: ("PINHOLE", 160, 120, [130.0, 132.0, 80.0, 60.0])}


def pose(number: float) -> torch.Tensor:
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[0, 3] = number
    return matrix


def write_scene(folder: Path, names: list[str], cameras=PINHOLE, suffix=".bin", reduce=1) -> None:
    """Images in this order of ids; every picture has one grey."""
    images = [(name, pose(k), 1) for k, name in enumerate(names)]
    write_colmap(folder / "sparse/0", cameras, images, suffix)
    _, width, height, _ = cameras[1]
    for k, name in enumerate(names):
        path = folder / ("images" if reduce == 1 else f"images_{reduce}") / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (width // reduce, height // reduce), (10 * k,) * 3).save(path)


def prepared(source: ColmapSource, output: Path) -> PreparationReport:
    return prepare(plan_preparation(source.jobs(), output), workers=1, progress=False)


@pytest.mark.parametrize("suffix", [".bin", ".txt"])
def test_frames_come_in_the_order_of_image_ids_with_their_cameras(tmp_path, suffix):
    names = ["z.png", "b/a.png", "m.png"]
    write_scene(tmp_path / "in/room", names, suffix=suffix)
    write_scene(tmp_path / "in/hall", ["a.png"], suffix=suffix)
    (tmp_path / "in/readme.txt").write_text("two scenes")
    source = ColmapSource(tmp_path / "in", size=32)
    assert [len(list(job.frames())) for job in pickle.loads(pickle.dumps(source.jobs()))] == [1, 3]
    report = prepared(source, tmp_path / "out")
    assert (report.scenes, report.frames, report.failed) == (2, 4, {})
    assert not list(verify(tmp_path / "out"))
    scene = read_scene(tmp_path / "out/room")
    assert (scene.info.dataset, scene.info.unit, scene.sources) == (
        "colmap",
        "arbitrary",
        tuple(names),
    )
    frames = PreparedScenes(tmp_path / "out").frames(1, [0, 1, 2])
    assert frames.images[:, 5, 5, 0].tolist() == [0, 10, 20]
    assert frames.world_from_cam[:, 0, 3].tolist() == pytest.approx([0.0, -1.0, -2.0])
    # 120 rows become 32: fx = 130 * 32 / 120.
    assert frames.intrinsics[0, 0, 0].item() == pytest.approx(130 * 32 / 120)


def test_mipnerf360_takes_the_reduced_photos_and_scales_their_cameras(tmp_path):
    names = [f"DSC{k}.png" for k in range(3)]
    write_scene(tmp_path / "in/garden", names, reduce=4)
    (tmp_path / "in/garden/images_4/DSC1.png").rename(tmp_path / "in/garden/images_4/DSC1.PNG")
    report = prepared(MipNeRF360Source(tmp_path / "in", size=30), tmp_path / "out")
    assert (report.frames, report.dropped, report.failed) == (3, {}, {})
    scene = read_scene(tmp_path / "out/garden")
    assert (scene.info.dataset, scene.info.split) == ("mipnerf360", "test")
    # 40 x 30 photos are cropped to 30 x 30: a quarter of the focal length remains.
    assert scene.intrinsics is not None
    assert scene.intrinsics[1] == pytest.approx(np.array([[32.5, 0, 15], [0, 33, 15], [0, 0, 1]]))


def test_missing_photos_are_dropped_and_counted(tmp_path):
    write_scene(tmp_path / "room", ["a.png", "b.png"])
    (tmp_path / "room/images/a.png").unlink()
    report = prepared(ColmapSource(tmp_path / "room", size=16), tmp_path / "out")
    assert (report.frames, report.dropped) == (1, {"a missing picture": 1})
    (tmp_path / "room/images/b.png").unlink()
    report = prepared(ColmapSource(tmp_path / "room", size=16), tmp_path / "out2")
    assert "no usable frame (dropped: 2 with a missing picture)" in report.failed["room"]


def test_bad_scenes_are_refused_with_a_reason_and_others_go_on(tmp_path):
    write_scene(tmp_path / "in/good", ["a.png"])
    write_scene(tmp_path / "in/cut", ["a.png"])
    model = tmp_path / "in/cut/sparse/0/images.bin"
    model.write_bytes(model.read_bytes()[:-9])
    fisheye = {1: ("OPENCV_FISHEYE", 40, 30, [30.0, 30.0, 20.0, 15.0, 0.1, 0.0, 0.0, 0.0])}
    write_scene(tmp_path / "in/fisheye", ["a.png"], fisheye)
    write_scene(tmp_path / "in/other_size", ["a.png"])
    Image.new("RGB", (99, 99)).save(tmp_path / "in/other_size/images/a.png")
    report = prepared(ColmapSource(tmp_path / "in", size=16), tmp_path / "out")
    assert report.scenes == 1
    assert "cut off" in report.failed["cut"]
    assert "a.png: COLMAP's lens model OPENCV_FISHEYE is not supported" in report.failed["fisheye"]
    assert "image of 160 x 120, but the photo has 99 x 99" in report.failed["other_size"]


def test_of_several_models_the_largest_is_prepared_and_told(tmp_path):
    write_scene(tmp_path / "in/room", ["a.png", "b.png", "c.png"])
    (tmp_path / "in/room/sparse/0").rename(tmp_path / "in/room/sparse/1")
    images = [("a.png", pose(0), 1), ("z.png", pose(1), 1)]
    write_colmap(tmp_path / "in/room/sparse/0", PINHOLE, images, ".txt")
    with pytest.warns(UserWarning, match=r"2 COLMAP models .*sparse/1 is used.* 1 photos: z\.png"):
        report = prepared(ColmapSource(tmp_path / "in", size=16), tmp_path / "out")
    assert (report.frames, report.dropped, report.failed) == (3, {}, {})


def test_models_within_a_scene_are_told_once(tmp_path):
    write_scene(tmp_path / "room", ["a.png", "b.png"])
    write_colmap(tmp_path / "room/sparse/1", PINHOLE, [("z.png", pose(0), 1)], ".bin")
    with pytest.warns(UserWarning, match="2 COLMAP models") as caught:
        (job,) = ColmapSource(tmp_path / "room", size=16).jobs()
    assert job.info.name == "room"
    assert len(caught) == 1


def test_photos_that_the_model_does_not_name_are_told(tmp_path):
    write_scene(tmp_path / "room", [f"{k}.png" for k in range(4)])
    images = [(f"{k}.png", pose(k), 1) for k in (1, 3)]
    write_colmap(tmp_path / "room/sparse/0", PINHOLE, images, ".bin")
    with pytest.warns(UserWarning, match=r"2 of 4 photos in .* left out: 0\.png, 2\.png"):
        report = prepared(ColmapSource(tmp_path / "room", size=16), tmp_path / "out")
    assert report.frames == 2


@pytest.mark.parametrize("form", ["{}.png", "{}", "{}.JPG", "./{}.png"])
def test_photos_are_found_whatever_their_ending(tmp_path, form):
    stems = ["frame.0001", "frame.0002", "left\\3"]
    write_scene(tmp_path / "room", [f"{stem}.png".replace("\\", "/") for stem in stems])
    images = [(form.format(stem), pose(k), 1) for k, stem in enumerate(stems)]
    write_colmap(tmp_path / "room/sparse/0", PINHOLE, images, ".txt")
    report = prepared(ColmapSource(tmp_path / "room", size=16), tmp_path / "out")
    assert (report.frames, report.dropped, report.failed) == (3, {}, {})


def test_photos_that_differ_only_in_ending_are_refused_where_that_counts(tmp_path):
    write_scene(tmp_path / "room", ["a.png"])
    Image.new("RGB", (160, 120)).save(tmp_path / "room/images/a.jpg")
    assert prepared(ColmapSource(tmp_path / "room", size=16), tmp_path / "out").frames == 1
    (tmp_path / "room/images/a.png").rename(tmp_path / "room/images/a.webp")
    report = prepared(ColmapSource(tmp_path / "room", size=16), tmp_path / "out2")
    assert "names a.png, which may be a.jpg or a.webp" in report.failed["room"]


def test_a_damaged_model_among_several_fails_alone(tmp_path):
    write_scene(tmp_path / "in/good", ["a.png"])
    write_scene(tmp_path / "in/bad", ["a.png"])
    write_colmap(tmp_path / "in/bad/sparse/1", PINHOLE, [], ".txt")
    (tmp_path / "in/bad/sparse/1/images.txt").write_text("1 2 3")
    report = prepared(ColmapSource(tmp_path / "in", size=16), tmp_path / "out")
    assert report.scenes == 1
    assert "sparse/1/images.txt is damaged" in report.failed["bad"]


def test_cameras_that_make_no_sense_fail_with_their_reason(tmp_path):
    write_scene(tmp_path / "in/far", ["a.png", "b.png"])
    images = [("a.png", pose(0), 1), ("b.png", pose(1e30), 1)]
    write_colmap(tmp_path / "in/far/sparse/0", PINHOLE, images, ".bin")
    upside = {1: ("PINHOLE", 160, 120, [130.0, -132.0, 80.0, 60.0])}
    write_scene(tmp_path / "in/focal", ["a.png"], upside)
    nothing = {1: ("OPENCV", 160, 120, [130.0, 132.0, 80.0, 60.0, float("nan"), 0.0, 0.0, 0.0])}
    write_scene(tmp_path / "in/nothing", ["a.png"], nothing)
    report = prepared(ColmapSource(tmp_path / "in", size=16), tmp_path / "out")
    assert report.scenes == 0
    assert "b.png stands 1e+30 units from the origin" in report.failed["far"]
    assert "a.png has the focal length -132" in report.failed["focal"]
    assert "distortion that is not finite" in report.failed["nothing"]


def test_links_that_lead_nowhere_and_pipes_are_no_photos(tmp_path):
    write_scene(tmp_path / "room", ["a.png", "b.png"])
    (tmp_path / "room/images/c.png").symlink_to(tmp_path / "gone.png")
    (tmp_path / "room/images/round").symlink_to(tmp_path / "room/images")
    (tmp_path / "room/images/b.png").unlink()
    os.mkfifo(tmp_path / "room/images/b.png")
    report = prepared(ColmapSource(tmp_path / "room", size=16), tmp_path / "out")
    assert (report.frames, report.dropped) == (1, {"a missing picture": 1})


def test_lens_distortion_is_taken_out(tmp_path):
    lens = {1: ("SIMPLE_RADIAL", 160, 120, [130.0, 80.0, 60.0, -0.1])}
    write_scene(tmp_path / "room", ["a.png"], lens)
    x, y = np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5)
    pixels = np.stack([1.5 * x, 2.0 * y, 0 * x], axis=-1).round().astype(np.uint8)
    Image.fromarray(pixels).save(tmp_path / "room/images/a.png")
    assert prepared(ColmapSource(tmp_path / "room", size=60), tmp_path / "out").failed == {}
    frame = PreparedScenes(tmp_path / "out").frames(0, [0])
    # The ray (0.3, 0.2) is bent to 1 - 0.1 * 0.13 = 0.987 of itself by the lens.
    pixel = frame.intrinsics[0] @ torch.tensor([0.3, 0.2, 1.0], dtype=torch.float64)
    red, green, _ = frame.images[0, int(pixel[1]), int(pixel[0])].tolist()
    shift = 130 / frame.intrinsics[0, 0, 0].item()  # photo pixels in one of the frame
    assert red / 1.5 == pytest.approx(80 + 130 * 0.3 * 0.987, abs=0.5 * shift + 0.7)
    assert green / 2.0 == pytest.approx(60 + 130 * 0.2 * 0.987, abs=0.5 * shift + 0.7)


def test_folders_without_scenes_are_told(tmp_path):
    with pytest.raises(FileNotFoundError, match="no folder"):
        ColmapSource(tmp_path / "nowhere").jobs()
    with pytest.raises(FileNotFoundError, match="holds no COLMAP scene"):
        ColmapSource(tmp_path).jobs()


def test_a_scene_without_its_photos_fails_alone(tmp_path):
    write_scene(tmp_path / "in/hall", ["a.png"])
    write_scene(tmp_path / "in/room", ["a.png"], reduce=4)
    report = prepared(MipNeRF360Source(tmp_path / "in", size=16), tmp_path / "out")
    assert report.scenes == 1
    assert report.failed == {
        "hall": f"there is no folder of photos {tmp_path}/in/hall/images_4; name it with --images"
    }


def test_photos_without_a_model_are_left_out_with_a_warning(tmp_path):
    write_scene(tmp_path / "hall", ["a.png"])
    (tmp_path / "room/images").mkdir(parents=True)
    with pytest.warns(UserWarning, match=r"1 folders with photos .* no COLMAP model .*room"):
        assert len(ColmapSource(tmp_path).jobs()) == 1


def test_real_cameras_of_garden_survive(shared, tmp_path):
    data = np.load(shared / "data/mipnerf360/test_garden.npz")
    fx, fy, cx, cy = (float(data["Ks"][0][at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    # COLMAP saw the photos at four times the size.
    cameras = {1: ("PINHOLE", 4 * 648, 4 * 420, [4 * fx, 4 * fy, 4 * cx, 4 * cy])}
    matrices = torch.from_numpy(data["viewmats"]).double()
    images = [(f"{k}.png", matrix, 1) for k, matrix in enumerate(matrices)]
    write_colmap(tmp_path / "garden/sparse/0", cameras, images, ".bin")
    (tmp_path / "garden/images_4").mkdir()
    for name, _, _ in images:
        Image.new("RGB", (648, 420)).save(tmp_path / "garden/images_4" / name)
    assert prepared(MipNeRF360Source(tmp_path / "garden"), tmp_path / "out").failed == {}
    scene = read_scene(tmp_path / "out/garden")
    assert scene.world_from_cam == pytest.approx(invert_rigid(matrices).numpy(), abs=1e-5)
    # The principal point (324.19, 210.06) is cropped about (324, 210): 420 rows become 256.
    scale = 256 / 420
    expected = [
        [fx * scale, 0, 128 + (cx - 324) * scale], [0, fy * scale, 128 + (cy - 210) * scale],
        [0, 0, 1],
    ]  # fmt: skip
    assert scene.intrinsics is not None
    assert scene.intrinsics[2] == pytest.approx(np.array(expected))


def test_another_scene_of_the_same_name_is_refused_instead_of_skipped(tmp_path):
    write_scene(tmp_path / "a/dense", ["0.png", "1.png"])
    write_scene(
        tmp_path / "b/dense", ["0.png", "1.png"], {1: ("PINHOLE", 160, 120, [90, 90, 80, 60])}
    )
    prepared(ColmapSource(tmp_path / "a/dense", size=32), tmp_path / "out")
    with pytest.raises(ValueError, match=r"scene dense with settings\.origin '2 files"):
        plan_preparation(ColmapSource(tmp_path / "b/dense", size=32).jobs(), tmp_path / "out")
