"""A damaged scan, archive or table of ScanNet is read, or refused in one line."""

import io
import json
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from instok3d.datasets.scannet.export import scan_frames
from instok3d.datasets.scannet.exported import lsm_frames, processed_frames
from instok3d.datasets.scannet.id_maps import IdMaps, largest_instance
from instok3d.datasets.scannet.sens import SensFile
from instok3d.datasets.scannet.splits import published_test_scenes
from mutations import of_bytes, of_json, of_zip, survive
from scannet_files import INTRINSICS, as_tar, write_lsm, write_processed, write_scan

SCAN = "scene0000_00"
SHIFT_BYTE = 4 + 8 + 15 + 256 + 24  # of the header: version, name, matrices, kinds and sizes


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    return write_scan(tmp_path, num_frames=2) / f"{SCAN}.sens"


def test_a_scan(scan: Path):
    assert survive(scan, lambda: list(scan_frames(scan, stride=1, size=24)), of_bytes, 150)


@pytest.mark.parametrize("damage", [of_zip, of_bytes])
def test_an_archive(scan: Path, damage):
    archive = scan.with_name(f"{SCAN}_2d-label-filt.zip")

    def read() -> None:
        with IdMaps(archive, "label-filt") as maps:
            for frame in range(2):
                maps.read(frame, 64 * 48)

    assert survive(archive, read, damage, 100)


def test_an_aggregation(scan: Path):
    file = scan.with_name(f"{SCAN}.aggregation.json")
    assert survive(file, lambda: largest_instance(file), of_json, 150)


@pytest.mark.parametrize("damage", [of_zip, of_bytes])
def test_cameras_of_an_exported_scan(tmp_path: Path, damage):
    root = write_processed(tmp_path, num_frames=1).parent
    file = root / SCAN / "pose" / "000000.npz"
    assert survive(file, lambda: list(processed_frames(root, SCAN, size=24)), damage, 150)


def test_a_tar_file(tmp_path: Path):
    archive = as_tar(write_lsm(tmp_path, {SCAN: (0,)}))
    path = f"scannet_test/{SCAN}"
    assert survive(archive, lambda: list(lsm_frames(archive, path, None, size=24)), of_bytes, 100)


def test_a_list_of_test_scenes(tmp_path: Path):
    file = tmp_path / "selected_seqs_test.json"
    file.write_text(json.dumps({SCAN: ["0", "10"], "scene0001_00": ["0"]}))
    read = lambda: published_test_scenes(file.read_bytes(), str(file))  # noqa: E731
    assert survive(file, read, of_json, 100)


@pytest.mark.parametrize("shift", [np.inf, np.nan, -1000.0, 0.0, 1e-30])
def test_a_shift_that_cannot_be_is_refused(scan: Path, shift: float):
    data = bytearray(scan.read_bytes())
    struct.pack_into("<f", data, SHIFT_BYTE, shift)
    scan.write_bytes(data)
    with pytest.raises(ValueError, match=r"scene0000_00\.sens has a damaged header: .*shift"):
        SensFile(scan)


def test_sizes_that_would_fill_the_memory_are_refused(scan: Path):
    data = bytearray(scan.read_bytes())
    struct.pack_into("<II", data, SHIFT_BYTE - 8, 16_000, 16_000)
    scan.write_bytes(data)
    with pytest.raises(ValueError, match=r"scene0000_00\.sens has a damaged header: sizes"):
        SensFile(scan)


@pytest.mark.parametrize(
    ("row", "column", "value", "reason"),
    [
        (0, 0, -57.8, "focal length -57.8"), (1, 0, 5.0, "5 below the diagonal"),
        (2, 0, 0.1, "last row"), (0, 2, 3.0, "principal point"), (1, 1, np.nan, "not finite"),
        (0, 0, 1e9, "focal lengths 1e.09"),
    ],
)  # fmt: skip
def test_intrinsics_that_cannot_be_are_refused(tmp_path, row, column, value, reason):
    wrong = INTRINSICS.copy()
    wrong[row, column] = value
    sens = write_scan(tmp_path, num_frames=1, intrinsics=wrong) / f"{SCAN}.sens"
    with pytest.raises(ValueError, match=rf"scene0000_00\.sens .*{reason}"):
        list(scan_frames(sens, stride=1, size=24))


def test_an_array_that_promises_too_much_is_refused_before_it_is_made(tmp_path: Path):
    root = write_processed(tmp_path, num_frames=1).parent
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"shape": (10**6, 10**6), "fortran_order": False, "descr": "<f8"}
    )
    with zipfile.ZipFile(root / SCAN / "pose" / "000000.npz", "w") as archive:
        archive.writestr("camera_pose.npy", header.getvalue())
        archive.writestr("camera_intrinsics.npy", header.getvalue())
    with pytest.raises(
        ValueError, match=r"pose/000000\.npz, camera_pose is damaged .*000000 bytes"
    ):
        list(processed_frames(root, SCAN, size=24))


def test_a_frame_number_of_too_many_digits_is_no_map(scan: Path):
    archive = scan.with_name(f"{SCAN}_2d-label-filt.zip")
    with zipfile.ZipFile(archive, "w") as stream:
        stream.writestr(f"label-filt/{'9' * 5000}.png", b"")
    with pytest.raises(ValueError, match=r"label-filt\.zip holds no label-filt/<frame>\.png but"):
        IdMaps(archive, "label-filt")
