import io
import tarfile
from pathlib import Path

import numpy as np
import pytest

from instok3d.datasets.prepared import DroppedFrame, PreparedFrame
from instok3d.datasets.scannet.exported import MOST_BYTES, FileTree, lsm_frames, processed_frames
from scannet_files import as_tar, depth_mm, huge_png, id_map, write_lsm, write_processed

SCAN = "scene0000_00"
CROP = (slice(1, None, 2), slice(9, 57, 2))
"""48 x 64 to 24 x 24: the middle 48 x 48, halved (worked out in test_export.py)."""


def kept(frames) -> list[PreparedFrame]:
    return [frame for frame in frames if isinstance(frame, PreparedFrame)]


def test_a_processed_scan_comes_out_cropped_and_without_ids(tmp_path: Path):
    root = write_processed(tmp_path, num_frames=3).parent
    frames = kept(processed_frames(root, SCAN, size=24))
    assert [frame.source for frame in frames] == ["000000", "000001", "000002"]
    for number, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.depth_thousandths, depth_mm(number)[CROP])
        assert frame.world_from_cam[0, 3] == 0.01 * number
        expected = [[28.9, 0, 12], [0, 28.9, 12], [0, 0, 1]]
        np.testing.assert_allclose(frame.intrinsics, expected)
        assert frame.instances is None
        assert frame.labels is None


def test_a_test_scene_comes_out_in_the_order_of_its_frame_numbers(tmp_path: Path):
    root = write_lsm(tmp_path, {SCAN: (0, 100, 20)})
    frames = kept(lsm_frames(root, SCAN, None, size=24))
    assert [frame.source for frame in frames] == ["0", "20", "100"]
    for frame in frames:
        number = int(frame.source)
        np.testing.assert_array_equal(frame.labels, 300 * id_map(number, (48, 64))[CROP])
        np.testing.assert_array_equal(frame.depth_thousandths, depth_mm(number)[CROP])


def test_a_tar_file_is_read_like_its_folder(tmp_path: Path):
    folder = write_lsm(tmp_path, {SCAN: (0, 10)})
    archive = as_tar(folder)
    there = kept(lsm_frames(folder, SCAN, None, size=24))
    packed = kept(lsm_frames(archive, f"scannet_test/{SCAN}", None, size=24))
    assert len(there) == len(packed) == 2
    for one, other in zip(there, packed, strict=True):
        np.testing.assert_array_equal(one.image, other.image)
        np.testing.assert_array_equal(one.labels, other.labels)
        np.testing.assert_array_equal(one.world_from_cam, other.world_from_cam)


def test_only_chosen_frames_are_taken_and_missing_ones_counted(tmp_path: Path):
    root = write_lsm(tmp_path, {SCAN: (0, 10, 20, 30)})
    (root / SCAN / "depths" / "20.png").unlink()
    frames = list(lsm_frames(root, SCAN, ["0", "20", "40.jpg"], size=24))
    assert [frame.source for frame in kept(frames)] == ["0"]
    dropped = {f.source: f.reason for f in frames if isinstance(f, DroppedFrame)}
    assert dropped == {"20": "no depth", "40": "no image"}


def test_frames_without_a_finite_pose_are_dropped(tmp_path: Path):
    folder = write_processed(tmp_path, num_frames=2)
    arrays = dict(np.load(folder / "pose" / "000001.npz"))
    np.savez(folder / "pose" / "000001.npz", **(arrays | {"camera_pose": np.full((4, 4), np.nan)}))
    frames = list(processed_frames(folder.parent, SCAN, size=24))
    assert isinstance(frames[1], DroppedFrame)
    assert frames[1].reason == "a pose that is not finite"


def pickled_npz() -> bytes:
    stream = io.BytesIO()
    np.savez(stream, camera_pose=np.array([object()]), camera_intrinsics=np.eye(3))
    return stream.getvalue()


def saved(**arrays: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


POSE, WIDE = np.eye(4), np.array([[1156.0, 0, 640], [0, 1156, 480], [0, 0, 1]])


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("pose/000000.npz", b"no zip", "is damaged"),
        ("pose/000000.npz", pickled_npz(), "is damaged"),
        ("pose/000000.npz", saved(camera_pose=POSE), "is damaged"),
        ("pose/000000.npz", saved(camera_pose=POSE)[:-30], "is damaged"),
        ("pose/000000.npz", saved(camera_pose=POSE).replace(b"\0\xf0\x3f", b"123"), "is damaged"),
        ("pose/000000.npz", saved(camera_pose=POSE, camera_intrinsics=np.eye(2)), "shape"),
        ("pose/000000.npz", saved(camera_pose=POSE, camera_intrinsics=WIDE), "another resolution"),
        ("color/000000.png", b"no picture", "is damaged"),
        ("color/000000.png", huge_png(), "is damaged"),
        ("depth/000000.png", b"no picture", "is damaged or"),
    ],
)
def test_a_damaged_file_is_named(tmp_path: Path, name: str, data: bytes, message: str):
    folder = write_processed(tmp_path, num_frames=1)
    (folder / name).write_bytes(data)
    with pytest.raises(ValueError, match=message) as error:
        list(processed_frames(folder.parent, SCAN, size=24))
    assert Path(name).name in str(error.value) or "color/000000.png" in str(error.value)


def read_all(archive: Path) -> None:
    tree = FileTree(archive, "scannet_test")
    for name in sorted(tree.names):
        tree.read(name)


def test_a_cut_tar_is_refused(tmp_path: Path):
    archive = as_tar(write_lsm(tmp_path, {SCAN: (0,)}))
    data = archive.read_bytes()
    for end in (len(data) // 2, 700):
        archive.write_bytes(data[:end])
        with pytest.raises(ValueError, match=r"damaged|cut off"):
            read_all(archive)
    archive.write_bytes(data)
    with tarfile.open(archive) as whole:
        headers = [member.offset for member in whole]
    for header in headers[1:]:  # tarfile takes these for the end
        for end in (header, header + 100):
            archive.write_bytes(data[:end])
            with pytest.raises(ValueError, match="cut off"):
                read_all(archive)
    archive.write_bytes(b"no tar at all" * 100)
    with pytest.raises(ValueError, match="is damaged"):
        FileTree(archive)


def test_a_file_that_is_not_in_the_tree_is_named(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match=r"a/b\.png"):
        FileTree(tmp_path, "a").read("b.png")


@pytest.mark.parametrize(("size", "is_refused"), [(MOST_BYTES + 1, 1), (2**40, 1), (8, 0)])
def test_a_file_too_large_for_memory_is_refused_by_its_header(
    tmp_path: Path, size: int, is_refused: int
):
    info, path = tarfile.TarInfo("a/depth.png"), tmp_path / "a.tar"
    info.size = size
    header = info.tobuf(tarfile.GNU_FORMAT)
    with path.open("wb") as stream:
        stream.write(header)
        stream.truncate(len(header) + -(-size // 512) * 512 + 1024)  # takes no place on the disk
    tree = FileTree(path)
    if is_refused:
        with pytest.raises(ValueError, match=rf"a\.tar: a/depth\.png has {size} bytes, far too"):
            tree.read("a/depth.png")
    else:
        assert tree.read("a/depth.png") == bytes(size)
