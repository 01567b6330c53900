import json
from pathlib import Path

import numpy as np
import pytest

from instok3d.datasets.preparation import plan_preparation, prepare
from instok3d.datasets.prepared import PreparedScenes, read_index, read_scene, verify
from instok3d.datasets.scannet.source import ScanNetSource
from scannet_files import as_tar, poses, write_lsm, write_processed, write_scan


def prepared(source: ScanNetSource, folder: Path):
    return prepare(plan_preparation(source.jobs(), folder), workers=1, progress=False)


def splits(source: ScanNetSource) -> dict[str, str]:
    return {job.info.name: job.info.split for job in source.jobs()}


def test_scans_become_a_folder_that_training_reads(tmp_path: Path):
    write_scan(tmp_path / "scannet" / "scans", "scene0000_00", 21)
    write_scan(tmp_path / "scannet" / "scans", "scene0641_00", 11)
    report = prepared(ScanNetSource(tmp_path / "scannet", size=24, min_frames=1), tmp_path / "out")
    assert (report.scenes, report.frames, report.failed) == (2, 5, {})
    assert list(verify(tmp_path / "out")) == []
    scenes = PreparedScenes(tmp_path / "out")
    assert scenes.name_of(0) == "scene0000_00"
    frames = scenes.frames(0, [0, 2])
    assert frames.images.shape == (2, 24, 24, 3)
    assert set(frames.instances.unique().tolist()) == {0, 1, 2, 3, 4, 5}
    np.testing.assert_allclose(frames.world_from_cam[1], poses(21)[20], atol=1e-7)
    assert frames.depths_m.min() > 1
    assert read_index(tmp_path / "out")["scene0641_00"]["split"] == "val"


def test_the_test_scenes_come_from_the_published_list_where_it_lies(tmp_path: Path):
    for name in ("scene0640_00", "scene0686_01", "scene0688_00"):
        write_scan(tmp_path, name, 1)
    by_rule = {"scene0640_00": "train", "scene0686_01": "test", "scene0688_00": "test"}
    assert splits(ScanNetSource(tmp_path)) == by_rule
    (tmp_path / "selected_seqs_test.json").write_text(json.dumps({"scene0688_00": [0]}))
    assert splits(ScanNetSource(tmp_path)) == by_rule | {"scene0686_01": "val"}
    assert list(splits(ScanNetSource(tmp_path, splits=("test",)))) == ["scene0688_00"]


def test_a_lost_pose_among_the_first_frames_keeps_a_scan_out_of_the_test(tmp_path: Path):
    lost = poses(40)
    lost[30] = np.full((4, 4), np.nan)
    between = poses(40)
    between[31] = np.full((4, 4), np.nan)  # frame 31 is not among 0, 10, 20, ...
    write_scan(tmp_path, "scene0687_00", 40, world_from_cam=lost)
    write_scan(tmp_path, "scene0688_00", 40, world_from_cam=between)
    source = ScanNetSource(tmp_path, size=24, min_frames=1)
    assert splits(source) == {"scene0687_00": "val", "scene0688_00": "test"}
    prepared(source, tmp_path / "out")
    rule = read_index(tmp_path / "out")["scene0688_00"]["split_rule"]
    assert "1 scans with non-finite poses (scene0687_00)" in rule
    assert "48 of the 50 could not be checked" in rule


def test_short_scans_are_left_out_and_counted_but_not_those_of_the_test(tmp_path: Path):
    lost = poses(5)
    lost[3] = np.full((4, 4), np.nan)
    write_scan(tmp_path / "in", "scene0000_00", 5)
    write_scan(tmp_path / "in", "scene0001_00", 5, world_from_cam=lost)
    write_scan(tmp_path / "in", "scene0641_00", 4)
    write_scan(tmp_path / "in", "scene0688_00", 2)
    source = ScanNetSource(tmp_path / "in", size=24, stride=1, min_frames=5)
    report = prepared(source, tmp_path / "out")
    assert report.left_out == {"fewer than 5 frames (--min-frames)": 2}
    assert report.failed == {}
    assert sorted(read_index(tmp_path / "out")) == ["scene0000_00", "scene0688_00"]
    assert list(verify(tmp_path / "out")) == []
    assert ScanNetSource(tmp_path).min_frames == 33  # Uni3R leaves out scans of 32 or fewer


def test_scan_folders_without_a_sens_are_told(tmp_path: Path):
    write_scan(tmp_path / "scans", "scene0000_00", 1)
    (tmp_path / "scans" / "scene0001_00").mkdir()
    (tmp_path / "scans" / "notes").mkdir()
    for place in (tmp_path, tmp_path / "scans"):
        with pytest.warns(UserWarning, match=r"1 scans .* no \.sens, such as scene0001_00"):
            assert list(splits(ScanNetSource(place))) == ["scene0000_00"]


def test_names_that_are_no_scans_are_left_out_with_a_warning(tmp_path: Path):
    write_scan(tmp_path, "scene0000_00", 1)
    write_scan(tmp_path, "scene0707_00", 1)
    with pytest.warns(UserWarning, match="1 scans are left out .* such as scene0707_00"):
        assert list(splits(ScanNetSource(tmp_path))) == ["scene0000_00"]


def test_one_scan_may_be_given_as_the_folder(tmp_path: Path):
    folder = write_scan(tmp_path, "scene0005_01", 1)
    assert splits(ScanNetSource(folder)) == {"scene0005_01": "train"}


def test_a_damaged_scan_fails_alone_and_with_its_reason(tmp_path: Path):
    for number in range(4):
        write_scan(tmp_path / "in", f"scene000{number}_00", 11)
    sens = tmp_path / "in/scene0001_00/scene0001_00.sens"
    sens.write_bytes(sens.read_bytes()[:-500])
    (tmp_path / "in/scene0002_00/scene0002_00_2d-label-filt.zip").unlink()
    lost = tmp_path / "in/scene0003_00"
    (lost / "scene0003_00_2d-instance-filt.zip").write_bytes(
        (lost / "scene0003_00_2d-label-filt.zip").read_bytes()
    )
    report = prepared(ScanNetSource(tmp_path / "in", size=24, min_frames=1), tmp_path / "out")
    assert report.scenes == 1
    assert "cut off: it ends at byte" in report.failed["scene0001_00"]
    assert "no archive" in report.failed["scene0002_00"]
    assert "holds no instance-filt" in report.failed["scene0003_00"]
    assert list(verify(tmp_path / "out")) == []


def test_a_header_that_promises_too_many_frames_does_not_fill_the_estimate(tmp_path: Path):
    sens = write_scan(tmp_path / "in", "scene0000_00", 1) / "scene0000_00.sens"
    data = bytearray(sens.read_bytes())
    data[27 + 256 + 28 : 27 + 256 + 36] = (2**40).to_bytes(8, "little")  # after name, matrices
    sens.write_bytes(data)
    source = ScanNetSource(tmp_path / "in", size=24, min_frames=1)
    assert source.jobs()[0].estimated_bytes == 0
    report = prepared(source, tmp_path / "out")
    assert "is cut off" in report.failed["scene0000_00"]


def test_without_archives_scans_are_prepared_without_ids(tmp_path: Path):
    folder = write_scan(tmp_path / "in", "scene0001_00", 1)
    for path in folder.glob("*.zip"):
        path.unlink()
    source = ScanNetSource(tmp_path / "in", size=24, min_frames=1, instances=False, labels=False)
    prepared(source, tmp_path / "out")
    assert (PreparedScenes(tmp_path / "out").frames(0, [0]).instances == -1).all()


def test_a_processed_export_is_found_and_read(tmp_path: Path):
    write_processed(tmp_path, "scene0003_00", num_frames=3)
    write_processed(tmp_path, "scene0688_00", num_frames=3)
    source = ScanNetSource(tmp_path, size=24, min_frames=1)
    assert splits(source) == {"scene0003_00": "train", "scene0688_00": "test"}
    assert prepared(source, tmp_path / "out").frames == 6
    assert splits(ScanNetSource(tmp_path / "scannet_processed")) == splits(source)


def test_lsms_test_data_is_found_and_read_in_its_folder_and_its_tar(tmp_path: Path):
    scenes = {"scene0686_01": (0, 10), "scene0696_02": (0,), "scene0700_01": (10, 20, 30)}
    folder = write_lsm(tmp_path / "lsm", scenes)
    expected = {"scene0686_01": "test", "scene0700_01": "test"}
    for number, place in enumerate((folder, folder.parent, as_tar(folder))):
        source = ScanNetSource(place, size=24, min_frames=1)
        assert splits(source) == expected
        assert prepared(source, tmp_path / f"out{number}").frames == 5
    record = read_scene(tmp_path / "out2" / "scene0700_01")
    assert record.sources == ("10", "20", "30")
    assert "selected_seqs_test.json" in record.info.settings["split_rule"]


def test_without_its_list_lsms_data_is_divided_by_the_rule(tmp_path: Path):
    folder = write_lsm(tmp_path, {"scene0686_01": (0,), "scene0003_00": (0,)}, with_list=False)
    assert splits(ScanNetSource(folder)) == {"scene0686_01": "test"}


def test_an_estimate_is_near_what_is_written(tmp_path: Path):
    write_scan(tmp_path / "in", "scene0000_00", 31)
    job = ScanNetSource(tmp_path / "in", size=48, min_frames=1).jobs()[0]
    report = prepared(ScanNetSource(tmp_path / "in", size=48, min_frames=1), tmp_path / "out")
    assert (
        report.num_bytes < job.estimated_bytes < 10 * report.num_bytes
    )  # made-up pixels are smooth


def test_what_is_no_scannet_is_refused(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        ScanNetSource(tmp_path / "none").jobs()
    (tmp_path / "photos").mkdir()
    with pytest.raises(FileNotFoundError, match="holds no ScanNet scans; wanted"):
        ScanNetSource(tmp_path / "photos").jobs()
    write_scan(tmp_path / "in", "scene0000_00", 1)
    with pytest.raises(ValueError, match=r"none of the 1 scans .* is of the splits test"):
        ScanNetSource(tmp_path / "in", splits=("test",)).jobs()
    with pytest.raises(ValueError, match="size, stride and min_frames must be 1 or more"):
        ScanNetSource(tmp_path, stride=0)
