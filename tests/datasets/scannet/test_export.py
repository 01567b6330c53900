from pathlib import Path

import numpy as np
import pytest

from instok3d.datasets.poses import NO_POSE, NOT_RIGID
from instok3d.datasets.prepared import DroppedFrame, PreparedFrame
from instok3d.datasets.scannet.export import scan_frames
from instok3d.datasets.scannet.id_maps import write_id_maps
from instok3d.datasets.scannet.sens import RecordedFrame, write_sens
from scannet_files import COLOR_SIZE, INTRINSICS, color, depth_mm, id_map, poses, write_scan

NAME = "scene0000_00"


def frames_of(folder: Path, *, stride: int = 10, size: int = 24, **other):
    """All frames with everything that lies in the folder of a scan."""
    instances = folder / f"{NAME}_2d-instance-filt.zip"
    labels = folder / f"{NAME}_2d-label-filt.zip"
    aggregation = folder / f"{NAME}.aggregation.json"
    files = {"instances": instances, "labels": labels, "aggregation": aggregation} | other
    return list(scan_frames(folder / f"{NAME}.sens", stride=stride, size=size, **files))


def kept(frames: list[PreparedFrame | DroppedFrame]) -> list[PreparedFrame]:
    return [frame for frame in frames if isinstance(frame, PreparedFrame)]


def test_every_tenth_frame_comes_out_with_all_it_has(tmp_path: Path):
    frames = kept(frames_of(write_scan(tmp_path, num_frames=21)))
    assert [frame.source for frame in frames] == ["0", "10", "20"]
    np.testing.assert_allclose(frames[1].world_from_cam, poses(21)[10])
    for frame in frames:
        for pixels in (frame.image, frame.depth_thousandths, frame.instances, frame.labels):
            assert pixels is not None
            assert pixels.shape[:2] == (24, 24)


def test_cropped_intrinsics_by_hand(tmp_path: Path):
    # Depth 48 x 64 with the principal point in the middle: the largest square is 48 x 48 from
    # column 8 on; to 24 x 24 it is halved. f 57.8 / 2 = 28.9, cx (32 - 8) / 2 = 12, cy 24 / 2.
    frame = kept(frames_of(write_scan(tmp_path, num_frames=1)))[0]
    expected = [[28.9, 0, 12], [0, 28.9, 12], [0, 0, 1]]
    np.testing.assert_allclose(frame.intrinsics, expected, atol=1e-5)
    # Row 0 of the crop is at the centre of row 1 of the depth (0.5 * 2 = 1.0), columns likewise.
    assert frame.depth_thousandths is not None
    np.testing.assert_array_equal(frame.depth_thousandths, depth_mm(0)[1::2, 9:57:2])


def test_a_principal_point_off_the_middle_by_hand(tmp_path: Path):
    # (29.3, 25.4) rounds to (29, 25): margins 29 and 23, so the square of 46 around (29, 25) goes
    # to 23 x 23: f / 2, cx (29.3 - 6) / 2 = 11.65, cy (25.4 - 2) / 2 = 11.7.
    intrinsics = np.array([[57.8, 0, 29.3], [0, 57.8, 25.4], [0, 0, 1]])
    folder = write_scan(tmp_path, num_frames=1, intrinsics=intrinsics)
    frame = kept(frames_of(folder, size=23))[0]
    expected = [[28.9, 0, 11.65], [0, 28.9, 11.7], [0, 0, 1]]
    np.testing.assert_allclose(frame.intrinsics, expected, atol=1e-5)


def test_a_point_in_space_projects_onto_the_same_content_before_and_after(tmp_path: Path):
    # A soft white spot where the point is seen in the 480 x 640 picture; where is it afterwards?
    intrinsics = np.array([[577.0, 0, 318.9], [0, 578.0, 242.6], [0, 0, 1]])
    point = np.array([0.21, -0.13, 1.7])
    x, y = (intrinsics @ point)[:2] / point[2]
    rows, columns = np.mgrid[:480, :640] + 0.5
    spot = np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 8.0**2))
    image = np.repeat((255 * spot)[..., None], 3, axis=-1).astype(np.uint8)
    near = (1000 + 1000 * (spot > 0.5)).astype(np.uint16)
    path = tmp_path / f"{NAME}.sens"
    write_sens(path, [RecordedFrame(image, near, np.eye(4))], intrinsics)
    frame = kept(list(scan_frames(path, stride=10, size=256)))[0]
    expected = (frame.intrinsics @ point)[:2] / point[2]
    rows, columns = np.mgrid[:256, :256] + 0.5
    for weights in (frame.image[..., 0].astype(float), frame.depth_thousandths == 2000):
        found = [(weights * places).sum() / weights.sum() for places in (columns, rows)]
        np.testing.assert_allclose(found, expected, atol=0.1)


def test_colours_ids_and_depth_stay_on_top_of_each_other(tmp_path: Path):
    # Left of column 21 of the depth (42 of the colour's 128) everything is 1, right of it 2.
    left = np.arange(128)[None] < 42
    ids = np.broadcast_to(np.where(left, 1, 2), (96, 128)).astype(np.uint16)
    image = np.repeat(np.where(ids == 1, 40, 200)[..., None], 3, axis=-1).astype(np.uint8)
    path = tmp_path / f"{NAME}.sens"
    depth = np.where(np.arange(64)[None] < 21, 1000, 2000) * np.ones((48, 1))
    frame = RecordedFrame(image, depth.astype(np.uint16), np.eye(4))
    write_sens(path, [frame], INTRINSICS, jpeg_quality=100)
    write_id_maps(tmp_path / "i.zip", "instance-filt", {0: ids})
    out = kept(list(scan_frames(path, stride=1, size=48, instances=tmp_path / "i.zip")))[0]
    assert out.depth_thousandths is not None
    assert out.instances is not None
    np.testing.assert_array_equal(out.depth_thousandths, 1000 * out.instances.astype(int))
    np.testing.assert_array_equal(out.image[..., 0] > 120, out.instances == 2)
    assert (out.instances[:, 12:14] == [1, 2]).all()  # column 21 less the 8 that were cut


def test_lost_and_unannotated_frames_are_dropped_and_counted(tmp_path: Path):
    cameras = poses(51)
    cameras[10] = np.full((4, 4), -np.inf)
    cameras[20][1, 2] = np.nan
    cameras[30] = np.diag([1.0, 1.0, -1.0, 1.0])
    folder = write_scan(tmp_path, num_frames=51, world_from_cam=cameras, without_maps=[40])
    frames = frames_of(folder)
    assert [frame.source for frame in kept(frames)] == ["0", "50"]
    dropped = {f.source: f.reason for f in frames if isinstance(f, DroppedFrame)}
    missing = "no instance-filt and no label-filt map"
    assert dropped == {"10": NO_POSE, "20": NO_POSE, "30": NOT_RIGID, "40": missing}


def test_a_scan_alone_has_no_ids(tmp_path: Path):
    folder = write_scan(tmp_path, num_frames=1)
    frame = kept(frames_of(folder, instances=None, labels=None, aggregation=None))[0]
    assert frame.instances is None
    assert frame.labels is None
    with pytest.raises(FileNotFoundError, match=r"no archive .*other\.zip"):
        frames_of(folder, labels=folder / "other.zip")


def test_ids_of_another_size_or_scan_are_refused(tmp_path: Path):
    square = write_scan(tmp_path / "square", num_frames=1, id_size=(98, 98))
    with pytest.raises(ValueError, match=r"frame 0 has 98 x 98 pixels.* not the same view"):
        frames_of(square)
    folder = write_scan(tmp_path, num_frames=2)
    archive = folder / "longer.zip"
    write_id_maps(archive, "instance-filt", {7: id_map(7, COLOR_SIZE)})
    with pytest.raises(ValueError, match=r"map of frame 7, but .* has 2 frames"):
        frames_of(folder, instances=archive)
    write_id_maps(archive, "instance-filt", {0: np.full(COLOR_SIZE, 9)})
    with pytest.raises(ValueError, match=r"id 9 in frame 0.* belongs to another scan"):
        frames_of(folder, instances=archive)


def test_ids_of_the_depths_size_are_taken_too(tmp_path: Path):
    frame = kept(frames_of(write_scan(tmp_path, num_frames=1, id_size=(48, 64))))[0]
    np.testing.assert_array_equal(frame.instances, id_map(0, (48, 64))[1::2, 9:57:2])


@pytest.mark.parametrize("factor", [0.5, 2.0, np.nan])
def test_intrinsics_of_another_resolution_are_refused(tmp_path: Path, factor: float):
    folder = write_scan(tmp_path, num_frames=1, intrinsics=INTRINSICS * [[factor], [factor], [1]])
    with pytest.raises(ValueError, match=r"another resolution|not finite"):
        frames_of(folder)


def test_colour_of_another_aspect_is_refused(tmp_path: Path):
    path = tmp_path / f"{NAME}.sens"
    write_sens(path, [RecordedFrame(color(0, (98, 98)), depth_mm(0), np.eye(4))], INTRINSICS)
    with pytest.raises(ValueError, match=r"the colour of .* not the same view"):
        list(scan_frames(path, stride=1, size=24))
