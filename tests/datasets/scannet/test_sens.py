import struct
from pathlib import Path

import numpy as np
import pytest

from instok3d.datasets.scannet.sens import RecordedFrame, SensFile, write_sens
from scannet_files import COLOR_SIZE, DEPTH_SIZE, INTRINSICS, color, depth_mm, poses, write_scan

NAME = b"StructureSensor"
HEADER_BYTES = 4 + 8 + len(NAME) + 4 * 64 + 8 + 16 + 4 + 8  # method.md 6.1, one by one
FRAME_BYTES = 64 + 4 * 8


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    return write_scan(tmp_path, num_frames=3) / "scene0000_00.sens"


def test_the_bytes_are_those_of_version_4(scan: Path):
    data = scan.read_bytes()
    assert struct.unpack_from("<IQ", data) == (4, 15)
    assert data[12:27] == NAME
    intrinsic_depth = struct.unpack_from("<16f", data, 27 + 2 * 64)
    # The file counts pixels from the centre of the first: 32 - 0.5 and 24 - 0.5.
    assert intrinsic_depth[:7] == pytest.approx((57.8, 0, 31.5, 0, 0, 57.8, 23.5))
    kinds_and_sizes = struct.unpack_from("<iiIIIIfQ", data, 27 + 4 * 64)
    assert kinds_and_sizes == (2, 1, 130, 98, 64, 48, 1000.0, 3)
    frame = struct.unpack_from("<16fQQQQ", data, HEADER_BYTES)
    assert frame[:4] == (1, 0, 0, 0)
    jpeg = data[HEADER_BYTES + FRAME_BYTES :][: frame[18]]
    assert jpeg[:2] == b"\xff\xd8"
    assert jpeg[-2:] == b"\xff\xd9"


def test_what_was_written_is_read_back(scan: Path):
    with SensFile(scan) as read:
        assert (read.color_size, read.depth_size, read.frame_count) == (COLOR_SIZE, DEPTH_SIZE, 3)
        np.testing.assert_allclose(read.intrinsics, INTRINSICS, atol=1e-5)
        for number in (2, 0):  # any order
            np.testing.assert_array_equal(read.depth_mm(number), depth_mm(number))
            np.testing.assert_allclose(read.image(number), color(number), atol=4)  # JPEG
            np.testing.assert_allclose(read.frames[number].world_from_cam, poses(3)[number])


def test_only_the_first_frames_are_indexed_when_no_more_are_asked_for(scan: Path):
    with SensFile(scan, num_frames=2) as read:
        assert (len(read.frames), read.frame_count) == (2, 3)


def test_depth_in_other_units_becomes_millimetres(scan: Path):
    data = bytearray(scan.read_bytes())
    struct.pack_into("<f", data, HEADER_BYTES - 12, 5000.0)
    scan.write_bytes(data)
    with SensFile(scan) as read:
        np.testing.assert_array_equal(read.depth_mm(1), np.rint(depth_mm(1) / 5))


def test_a_pose_that_is_not_finite_is_read_as_it_is(tmp_path: Path):
    lost = np.full((4, 4), -np.inf)
    write_sens(tmp_path / "a.sens", [RecordedFrame(color(0), depth_mm(0), lost)], INTRINSICS)
    with SensFile(tmp_path / "a.sens") as read:
        assert np.isneginf(read.frames[0].world_from_cam).all()


def test_a_cut_file_names_frame_and_byte(scan: Path):
    data = scan.read_bytes()
    for end, where in (
        (0, "the header"),
        (100, "the header"),
        (HEADER_BYTES, "frame 0 of 3"),
        (HEADER_BYTES + 50, "frame 0 of 3"),
        (len(data) - 20, "frame 2 of 3"),
    ):
        scan.write_bytes(data[:end])
        with pytest.raises(ValueError, match=f"cut off: it ends at byte {end} in {where}"):
            SensFile(scan)


def test_a_file_that_ends_with_its_last_frame_is_whole(scan: Path):
    scan.write_bytes(scan.read_bytes()[:-8])  # without the count of IMU frames
    with SensFile(scan) as read:
        assert len(read.frames) == 3


def damaged(scan: Path, place: int, patch: bytes) -> Path:
    data = bytearray(scan.read_bytes())
    data[place : place + len(patch)] = patch
    scan.write_bytes(data)
    return scan


@pytest.mark.parametrize(
    ("place", "patch", "message"),
    [
        (0, struct.pack("<I", 3), "not a .sens file of version 4"),
        (0, b"PK\x03\x04", "not a .sens file of version 4"),
        (27 + 256, struct.pack("<i", 0), "colour of kind 0"),
        (27 + 256 + 4, struct.pack("<i", 2), "depth of kind 2"),
        (27 + 256 + 8, struct.pack("<I", 0), "damaged header"),
        (27 + 256 + 24, struct.pack("<f", 0.0), "damaged header"),
    ],
)
def test_other_files_are_refused(scan: Path, place: int, patch: bytes, message: str):
    with pytest.raises(ValueError, match=message):
        SensFile(damaged(scan, place, patch))


def test_a_damaged_picture_names_its_frame(scan: Path):
    with SensFile(scan) as whole:
        frame = whole.frames[1]
    with SensFile(damaged(scan, frame.color_start, b"\0" * 40)) as read:
        with pytest.raises(ValueError, match=r"JPEG of frame 1 .* is damaged"):
            read.image(1)
        assert read.image(0).size == (130, 98)
    damaged(scan, frame.depth_start, b"\0" * 4)
    with SensFile(scan) as read, pytest.raises(ValueError, match=r"depth of frame 1 .* is damaged"):
        read.depth_mm(1)


def test_a_depth_or_picture_of_another_size_than_the_header_is_refused(scan: Path):
    damaged(scan, 27 + 256 + 16, struct.pack("<II", 640, 480))
    with SensFile(scan) as read, pytest.raises(ValueError, match="not have the 480 x 640 pixels"):
        read.depth_mm(0)
    damaged(scan, 27 + 256 + 8, struct.pack("<II", 131, 98))
    with SensFile(scan) as read, pytest.raises(ValueError, match="98 x 130 pixels, the header"):
        read.image(0)


def test_a_scan_without_frames_or_of_mixed_sizes_is_not_written(tmp_path: Path):
    with pytest.raises(ValueError, match="at least one frame"):
        write_sens(tmp_path / "a.sens", [], INTRINSICS)
    mixed = [
        RecordedFrame(color(0), depth_mm(0), np.eye(4)),
        RecordedFrame(color(0), depth_mm(0, (24, 32)), np.eye(4)),
    ]
    with pytest.raises(ValueError, match="frame 1 has the sizes"):
        write_sens(tmp_path / "a.sens", mixed, INTRINSICS)
    assert list(tmp_path.iterdir()) == []


def test_a_scan_that_is_not_there_is_named(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match=r"no scan .*a\.sens"):
        SensFile(tmp_path / "a.sens")
