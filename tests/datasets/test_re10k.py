import io
import json
import math
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from instok3d.datasets import re10k
from instok3d.datasets.preparation import PreparationReport, plan_preparation, prepare
from instok3d.datasets.prepared import read_scene, verify
from instok3d.datasets.re10k import Re10kSource, read_camera_file, read_chunk
from instok3d.geometry.cameras import project, transform_points
from mutations import of_bytes, of_zip, survive

FX, FY = 0.5, 0.5 * 640 / 360


def jpeg(color: tuple[int, int, int] = (200, 100, 50), size: tuple[int, int] = (640, 360)) -> bytes:
    stream = io.BytesIO()
    Image.new("RGB", size, color).save(stream, "JPEG", quality=95)
    return stream.getvalue()


def as_tensor(data: bytes) -> torch.Tensor:
    return torch.tensor(list(data), dtype=torch.uint8)


def camera(frame: int, fx: float = FX, fy: float = FY) -> list[float]:
    """Turned by 0.1 rad a frame about y, and moved."""
    c, s = math.cos(0.1 * frame), math.sin(0.1 * frame)
    return [fx, fy, 0.5, 0.5, 0.0, 0.0, c, 0.0, s, 0.1 * frame, 0.0, 1.0, 0.0, 0.2, -s, 0.0, c, 1.0]


def clip(name: str = "a1", num_frames: int = 4, **changed: Any) -> dict[str, Any]:
    return {
        "url": "an address",
        "timestamps": torch.arange(num_frames),
        "cameras": torch.tensor([camera(k) for k in range(num_frames)]),
        "images": [as_tensor(jpeg()) for _ in range(num_frames)],
        "key": name,
        **changed,
    }


def write_chunks(folder: Path, chunks: dict[str, list[dict[str, Any]]]) -> None:
    folder.mkdir(parents=True)
    for name, clips in chunks.items():
        torch.save(clips, folder / name)
    index = {row["key"]: name for name, clips in chunks.items() for row in clips}
    (folder / "index.json").write_text(json.dumps(index))


def prepared(source: Path, output: Path, **settings: Any) -> PreparationReport:
    plan = plan_preparation(Re10kSource(source, **settings).jobs(), output)
    return prepare(plan, workers=1, progress=False)


def test_chunks_become_scenes_with_cameras_that_see_the_same_points(tmp_path):
    picture = Image.new("RGB", (640, 360))
    picture.paste((250, 250, 250), (440, 250, 460, 270))  # a white square about pixel (450, 260)
    stream = io.BytesIO()
    picture.save(stream, "JPEG", quality=95)
    marked = [as_tensor(jpeg()), as_tensor(stream.getvalue())]
    write_chunks(
        tmp_path / "in/train", {"000000.torch": [clip("a1", 2, images=marked), clip("b2")]}
    )
    write_chunks(tmp_path / "in/test", {"000000.torch": [clip("c3", 3)]})
    report = prepared(tmp_path / "in", tmp_path / "out")
    assert (report.scenes, report.frames, report.failed) == (3, 9, {})
    assert not list(verify(tmp_path / "out"))
    assert read_scene(tmp_path / "out/c3").info.split == "test"
    scene = read_scene(tmp_path / "out/a1")
    assert (scene.info.dataset, scene.info.split, scene.info.unit) == (
        "re10k",
        "train",
        "arbitrary",
    )
    assert scene.sources == ("0", "1")
    # f = 0.5 * 640 px, scaled by 256 / 360; the principal point is the middle.
    expected = [[0.5 * 640 * 256 / 360, 0, 128], [0, 0.5 * 640 * 256 / 360, 128], [0, 0, 1]]
    assert scene.intrinsics[1] == pytest.approx(np.array(expected))
    # A point seen in the middle of the white square lies there in the prepared picture too.
    pixel = torch.tensor([[450.0, 260.0, 1.0]], dtype=torch.float64)
    camera_ = torch.tensor([[320.0, 0, 320], [0, 320.0, 180], [0, 0, 1]], dtype=torch.float64)
    in_camera = 2.0 * pixel @ torch.linalg.inv(camera_).T
    true_cam_from_world = torch.eye(4, dtype=torch.float64)
    true_cam_from_world[:3] = torch.tensor(camera(1), dtype=torch.float64)[6:].view(3, 4)
    world = transform_points(torch.linalg.inv(true_cam_from_world), in_camera)
    again = transform_points(torch.linalg.inv(torch.from_numpy(scene.world_from_cam[1])), world)
    x, y = project(again, torch.from_numpy(scene.intrinsics[1]))[0].tolist()
    image = np.asarray(Image.open(tmp_path / "out/a1/images/000001.png").convert("L")).astype(float)
    rows, columns = np.nonzero(image > 125)
    assert (columns.mean() + 0.5, rows.mean() + 0.5) == pytest.approx((x, y), abs=0.3)


def test_jobs_can_be_sent_to_other_processes(tmp_path):
    write_chunks(tmp_path / "in/train", {"000000.torch": [clip("a1", 2)]})
    (job,) = pickle.loads(pickle.dumps(Re10kSource(tmp_path / "in").jobs()))
    assert len(list(job.frames())) == 2


def test_camera_files_with_frames_give_the_same_scene_as_a_chunk(tmp_path):
    write_chunks(tmp_path / "chunks/test", {"000000.torch": [clip("a1", 3)]})
    folder = tmp_path / "text/test"
    (folder / "a1").mkdir(parents=True)
    lines = [f"{1000 * k} {' '.join(f'{v:.9f}' for v in camera(k))}" for k in range(3)]
    (folder / "a1.txt").write_text("\n".join(["an address", *lines]) + "\n")
    for k in range(3):
        (folder / f"a1/{1000 * k}.jpg").write_bytes(jpeg())
    for kind in ("chunks", "text"):
        assert prepared(tmp_path / kind, tmp_path / f"{kind}_out").failed == {}
    chunk, text = (read_scene(tmp_path / f"{kind}_out/a1") for kind in ("chunks", "text"))
    assert text.files == chunk.files
    assert text.world_from_cam == pytest.approx(chunk.world_from_cam, abs=1e-6)
    assert text.intrinsics == pytest.approx(chunk.intrinsics, abs=1e-4)


def test_frames_that_cannot_be_used_are_dropped_counted_and_keep_the_numbers_of_the_others(
    tmp_path,
):
    cameras = torch.tensor([camera(k) for k in range(6)])
    cameras[1, 9] = math.nan
    cameras[2, 6] = 3.0
    cameras[3, 0] = 0.0
    cameras[4, :4] = torch.tensor([320.0, 320.0, 320.0, 180.0])  # in pixels
    write_chunks(tmp_path / "in/train", {"000000.torch": [clip("a1", 6, cameras=cameras)]})
    report = prepared(tmp_path / "in", tmp_path / "out")
    assert report.dropped == {
        "a pose that is not finite": 1, "a pose that is not rigid": 1,
        "intrinsics that are not shares of the picture's size": 2,
    }  # fmt: skip
    assert read_scene(tmp_path / "out/a1").sources == ("0", "5")


def test_clips_of_another_size_or_too_wide_are_left_out_and_counted(tmp_path):
    small = [as_tensor(jpeg(size=(480, 360)))] * 4
    # 2 atan(0.5 / 0.41) = 101.3 degrees; with 0.43 it is 98.6.
    wide = torch.tensor([camera(k, fx=0.41) for k in range(4)])
    narrow = torch.tensor([camera(k, fx=0.43) for k in range(4)])
    clips = [clip("a1", images=small), clip("b2", cameras=wide), clip("c3", cameras=narrow)]
    write_chunks(tmp_path / "in/train", {"000000.torch": clips})
    report = prepared(tmp_path / "in", tmp_path / "out")
    assert (report.scenes, report.failed) == (1, {})
    assert report.left_out == {
        "pictures that are not 640 x 360": 1, "a field of view over 100 degrees": 1
    }  # fmt: skip


def test_a_chunk_that_runs_code_is_refused_and_does_not_run(tmp_path):
    class Evil:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "was_run",))

    torch.save([clip(), Evil()], tmp_path / "evil.torch")
    with pytest.raises(ValueError, match=r"evil\.torch is refused: it holds more than tensors"):
        read_chunk(tmp_path / "evil.torch")
    assert not (tmp_path / "was_run").exists()


@pytest.mark.parametrize("keep", [0, 10, 0.5, 0.95])
def test_truncated_chunks_are_refused(tmp_path, keep):
    torch.save([clip()], tmp_path / "whole.torch")
    data = (tmp_path / "whole.torch").read_bytes()
    length = keep if isinstance(keep, int) else int(keep * len(data))
    (tmp_path / "cut.torch").write_bytes(data[:length])
    with pytest.raises(ValueError, match=r"cut\.torch is (cut off|refused)"):
        read_chunk(tmp_path / "cut.torch")


def test_a_chunk_whose_list_is_cut_is_refused(tmp_path):
    torch.save([clip()], tmp_path / "whole.torch")
    with (
        zipfile.ZipFile(tmp_path / "whole.torch") as whole,
        zipfile.ZipFile(tmp_path / "cut.torch", "w") as cut,
    ):
        for name in whole.namelist():
            # An unpickler that was promised four bytes of length and gets one.
            cut.writestr(name, b"\x80\x02X\x05" if "data.pkl" in name else whole.read(name))
    with pytest.raises(ValueError, match=r"cut\.torch is (cut off|refused)"):
        read_chunk(tmp_path / "cut.torch")


def test_a_chunk_that_is_no_list_is_refused(tmp_path):
    torch.save({"a": torch.ones(1)}, tmp_path / "odd.torch")
    with pytest.raises(ValueError, match="holds a dict, wanted a list of clips"):
        read_chunk(tmp_path / "odd.torch")


@pytest.mark.parametrize(
    ("row", "name", "message"),
    [
        ({"key": "b2", "cameras": torch.ones(2, 18)}, "b2", "has ['cameras', 'key'], wanted key"),
        (torch.ones(3), "train-000000-1", "the clip train-000000-1 has Tensor"),
        (clip("b2", cameras=torch.ones(4, 12)), "b2", "clip b2 are not rows of 18 numbers"),
        (clip("b2", cameras=torch.tensor(1.0)), "b2", "clip b2 are not rows of 18 numbers"),
        (clip("b2", cameras=torch.ones(3, 18)), "b2", "clip b2 has 3 cameras but 4 images"),
        (clip("b2", images=[torch.ones(5)] * 4), "b2", "clip b2 are not bytes (uint8)"),
        (clip("../b2"), "train-000000-1", "the key of the clip train-000000-1 is '../b2'"),
        (clip("a1"), "train-000000-1", "is 'a1', which cannot name a scene or is that of"),
        (clip("b2", key=7), "train-000000-1", "the key of the clip train-000000-1 is 7"),
    ],
)
@pytest.mark.parametrize("with_index", [False, True])
def test_a_malformed_clip_fails_alone(tmp_path, row, name, message, with_index):
    (tmp_path / "in/train").mkdir(parents=True)
    torch.save([clip("a1"), row, clip("c3")], tmp_path / "in/train/000000.torch")
    if with_index:
        index = dict.fromkeys(("a1", name, "c3"), "000000.torch")
        (tmp_path / "in/train/index.json").write_text(json.dumps(index))
    report = prepared(tmp_path / "in", tmp_path / "out")
    assert (report.scenes, [*report.failed]) == (2, [name])
    assert message in report.failed[name]


def test_damaged_chunks_without_index_fail_alone(tmp_path):
    for split in ("train", "test"):
        folder = tmp_path / "in" / split
        write_chunks(folder, {"000000.torch": [clip("a1")]})
        torch.save([clip(split), 7], folder / "000001.torch")
        (folder / "index.json").unlink()
        path = folder / "000000.torch"
        path.write_bytes(path.read_bytes()[:1000])
    report = prepared(tmp_path / "in", tmp_path / "out")
    assert report.scenes == 2
    assert sorted(report.failed) == [
        "test-000000.torch", "test-000001-1", "train-000000.torch", "train-000001-1"
    ]  # fmt: skip
    assert "train/000000.torch is cut off" in report.failed["train-000000.torch"]


def test_a_chunk_that_the_index_does_not_list_is_told(tmp_path):
    write_chunks(tmp_path / "in/train", {"000000.torch": [clip("a1")]})
    torch.save([clip("b2")], tmp_path / "in/train/000001.torch")
    with pytest.warns(UserWarning, match=r"1 chunks are left out .*, such as 000001\.torch"):
        assert len(Re10kSource(tmp_path / "in").jobs()) == 1


def test_one_bad_clip_is_reported_and_the_others_go_on(tmp_path):
    damaged = [as_tensor(jpeg()[:300])] * 4
    empty = {"cameras": torch.ones(0, 18), "images": [], "timestamps": torch.arange(0)}
    write_chunks(
        tmp_path / "in/train",
        {"000000.torch": [clip("a1"), clip("b2", images=damaged), clip("c3", **empty)],
         "000001.torch": [clip("d4")]},
    )  # fmt: skip
    index = json.loads((tmp_path / "in/train/index.json").read_text())
    (tmp_path / "in/train/index.json").write_text(json.dumps(index | {"e5": "000001.torch"}))
    report = prepared(tmp_path / "in", tmp_path / "out")
    assert report.scenes == 2
    assert sorted(report.failed) == ["b2", "c3", "e5"]
    assert "000000.torch: the picture of frame 0 of clip b2 is damaged" in report.failed["b2"]
    assert "c3 has no frame" in report.failed["c3"]
    assert "lacks the clip e5" in report.failed["e5"]


def one_value(size: int, dtype: torch.dtype) -> torch.Tensor:
    """A tensor that claims many values and stores one."""
    return torch.zeros(1, dtype=dtype).expand(size)


STRANGE: dict[str, dict[str, Any]] = {
    "cameras of complex numbers": {"cameras": torch.ones(4, 18, dtype=torch.complex64)},
    "sparse cameras": {"cameras": torch.ones(4, 18).to_sparse()},
    "cameras of none but 18": {"cameras": torch.ones(18)},
    "no cameras": {"cameras": None},
    "an image of one byte": {"images": [one_value(10**12, torch.uint8)] * 4},
    "empty images": {"images": [torch.zeros(0, dtype=torch.uint8)] * 4},
    "images that are none": {"images": [None] * 4},
    "no numbers": {"cameras": torch.full((4, 18), math.nan)},
    "huge numbers": {"cameras": torch.tensor([camera(k) for k in range(4)]) * 1e30},
    "far away": {"cameras": torch.tensor([[*camera(0)[:9], 1e20, *camera(0)[10:]]] * 4)},
}


@pytest.mark.parametrize("with_index", [True, False])
def test_one_strange_clip_of_any_kind_is_left_out_with_a_reason(tmp_path, with_index):
    strange = [clip(name, **changed) for name, changed in STRANGE.items()]
    write_chunks(tmp_path / "in/train", {"000000.torch": [clip("a1"), *strange, clip("z9")]})
    if not with_index:
        (tmp_path / "in/train/index.json").unlink()
    report = prepared(tmp_path / "in", tmp_path / "out")
    assert report.scenes == 2
    assert sorted(report.failed) == sorted(STRANGE)
    assert all("000000.torch" in reason or "no usable frame" in reason
               for reason in report.failed.values())  # fmt: skip
    assert not any("\n" in reason for reason in report.failed.values())


@pytest.mark.parametrize("key", ["../out", "x" * 300, "a\nb", "\ud800", "a1"])
def test_a_clip_whose_key_is_no_name_of_its_own_fails_alone(tmp_path, key):
    write_chunks(tmp_path / "in/train", {"000000.torch": [clip("a1")]})
    write_chunks(tmp_path / "in/test", {"000000.torch": [clip(key), clip("c3")]})
    for index in (True, False):
        if not index:
            for split in ("train", "test"):
                (tmp_path / "in" / split / "index.json").unlink()
        elif key == "\ud800":  # no JSON holds it
            with pytest.raises(ValueError, match=r"index\.json is damaged"):
                Re10kSource(tmp_path / "in").jobs()
            continue
        report = prepared(tmp_path / "in", tmp_path / f"out{index}")
        assert report.scenes == 2
        ((name, reason),) = report.failed.items()
        assert name.startswith("test-000000")
        assert "cannot name a scene or is that of another clip" in reason


def test_an_error_that_nobody_foresaw_ends_its_scene_alone(tmp_path, monkeypatch):
    write_chunks(tmp_path / "in/train", {"000000.torch": [clip("a1"), clip("b2")]})
    crop = re10k.crop_image

    def fault(image, pixel_map):
        if not done:
            done.append(True)
            raise ZeroDivisionError("no\nsuch thing")
        return crop(image, pixel_map)

    done: list[bool] = []
    monkeypatch.setattr(re10k, "crop_image", fault)
    report = prepared(tmp_path / "in", tmp_path / "out")
    assert report.scenes == 1
    assert report.failed == {"a1": "ZeroDivisionError: no such thing"}


@pytest.mark.parametrize(("zipped", "damage"), [(True, of_zip), (False, of_bytes)])
def test_a_damaged_chunk_is_refused_in_one_line(tmp_path, zipped, damage):
    file = tmp_path / "000000.torch"
    rows = [clip("a1", 1, images=[as_tensor(b"jpeg")]), clip("b2", 1, images=[as_tensor(b"")])]
    torch.save(rows, file, _use_new_zipfile_serialization=zipped)

    def read() -> None:
        clips = read_chunk(file)
        for key in clips:
            re10k._checked_clip(clips[key], file, key)

    assert survive(file, read, damage, 100)


def test_an_index_may_be_missing_but_not_lead_outside(tmp_path):
    write_chunks(
        tmp_path / "in/train", {"000000.torch": [clip("a1")], "000001.torch": [clip("b2")]}
    )
    with_index = Re10kSource(tmp_path / "in").jobs()
    (tmp_path / "in/train/index.json").unlink()
    assert [job.info for job in Re10kSource(tmp_path / "in").jobs()] == [j.info for j in with_index]
    # The folder of one split may be given itself.
    assert len(Re10kSource(tmp_path / "in/train").jobs()) == 2
    (tmp_path / "in/train/index.json").write_text('{"a1": "../000000.torch"}')
    with pytest.raises(ValueError, match="which is no name in its folder"):
        Re10kSource(tmp_path / "in").jobs()
    (tmp_path / "in/train/index.json").write_text("{")
    with pytest.raises(ValueError, match="is damaged"):
        Re10kSource(tmp_path / "in").jobs()


def test_folders_without_clips_and_missing_frames_are_told(tmp_path):
    with pytest.raises(FileNotFoundError, match="no folder"):
        Re10kSource(tmp_path / "nowhere").jobs()
    with pytest.raises(
        FileNotFoundError, match="holds no clips of RealEstate10K for train or test"
    ):
        Re10kSource(tmp_path).jobs()
    (tmp_path / "in/test").mkdir(parents=True)
    row = " ".join(map(str, camera(0)))
    (tmp_path / "in/test/a1.txt").write_text(f"an address\n10 {row}\n20 {row}\n")
    (tmp_path / "in/test/b2.txt").write_text("an address\n10 1 2 3\n")
    (tmp_path / "in/test/c3.txt").write_bytes(b"\xff\xfe")
    report = prepared(tmp_path / "in", tmp_path / "out")
    assert "with the frames of the clip a1; say with --images" in report.failed["a1"]
    assert "c3.txt is no camera file of RealEstate10K" in report.failed["c3"]
    assert "no camera file of RealEstate10K" in report.failed["b2"]
    (tmp_path / "frames/a1").mkdir(parents=True)
    (tmp_path / "frames/a1/20.jpg").write_bytes(jpeg())
    report = prepared(tmp_path / "in", tmp_path / "out", images=tmp_path / "frames")
    assert report.dropped == {"a missing picture": 1}
    assert read_scene(tmp_path / "out/a1").sources == ("1",)


def test_real_cameras_are_in_the_evaluation_index_and_are_rigid(shared):
    index = json.loads((shared / "data/re10k/evaluation_index_re10k.json").read_text())
    assert (len(index), sum(entry is not None for entry in index.values())) == (7194, 5601)
    files = sorted((shared / "data/re10k/camera_files").glob("*.txt"))
    assert len(files) == 10
    for path in files:
        cameras, times = read_camera_file(path)
        assert path.stem in index
        assert cameras.shape == (16, 18)
        assert all(np.diff(times) > 0)
        rotations = cameras[:, 6:].reshape(-1, 3, 4)[:, :, :3]
        assert np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max() < 1e-5
        assert np.linalg.det(rotations) == pytest.approx(np.ones(16), abs=1e-5)
        # Square pixels at 640 x 360: fx 640 = fy 360.
        assert cameras[:, 0] * 640 == pytest.approx(cameras[:, 1] * 360, rel=1e-3)


def test_real_frames_and_cameras_are_prepared(shared, tmp_path):
    path = sorted((shared / "data/re10k/camera_files").glob("*.txt"))[0]
    cameras, _ = read_camera_file(path)
    images = []
    for number in (0, 1):
        stream = io.BytesIO()
        photo = Image.open(shared / f"data/re10k/1eca36ec55b88fe4/context_{number}.png")
        photo.resize((640, 360)).save(stream, "JPEG")
        images.append(as_tensor(stream.getvalue()))
    row = clip("1eca36ec55b88fe4", cameras=torch.from_numpy(cameras[:2]).float(), images=images)
    write_chunks(tmp_path / "in/test", {"000000.torch": [row]})
    assert prepared(tmp_path / "in", tmp_path / "out", size=64).failed == {}
    scene = read_scene(tmp_path / "out/1eca36ec55b88fe4")
    assert (scene.height, scene.width) == (64, 64)
    kept = np.asarray(Image.open(tmp_path / "out/1eca36ec55b88fe4/images/000001.png"))
    middle = photo.crop((98, 0, 350, 448)).resize((64, 64), Image.Resampling.BOX)
    assert np.abs(kept.astype(float) - np.asarray(middle)).mean() < 6
