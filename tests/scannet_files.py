"""Small true files in the forms in which ScanNet comes: scans, archives, exports of others."""

import io
import json
import struct
import tarfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from instok3d.datasets.scannet.id_maps import write_id_maps
from instok3d.datasets.scannet.sens import RecordedFrame, write_sens

DEPTH_SIZE = (48, 64)
COLOR_SIZE = (98, 130)
"""2.04 and 2.03 times the depth, as ScanNet's 968 x 1296 are about twice its 480 x 640."""
INTRINSICS = np.array([[57.8, 0, 32.0], [0, 57.8, 24.0], [0, 0, 1.0]])


def poses(num_frames: int) -> list[np.ndarray]:
    """A camera that moves along x, 1 cm a frame."""
    made = [np.eye(4) for _ in range(num_frames)]
    for number, pose in enumerate(made):
        pose[0, 3] = 0.01 * number
    return made


def id_map(number: int, size: tuple[int, int], most: int = 5) -> np.ndarray:
    """Ids in blocks, other ones in each frame, among them 0."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    return ((rows * 4 // size[0] + columns * 5 // size[1] + number) % (most + 1)).astype(np.uint16)


def color(number: int, size: tuple[int, int] = COLOR_SIZE) -> np.ndarray:
    """Smooth colours, so that JPEG hardly changes them."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    channels = [
        80 + 100 * rows / size[0],
        80 + 100 * columns / size[1],
        np.full(size, 50.0 + number % 100),
    ]
    return np.stack(channels, axis=-1).astype(np.uint8)


def depth_mm(number: int, size: tuple[int, int] = DEPTH_SIZE) -> np.ndarray:
    rows, columns = np.mgrid[: size[0], : size[1]]
    return (1000 + 10 * rows + columns + number).astype(np.uint16)


def write_scan(
    root: Path,
    name: str = "scene0000_00",
    num_frames: int = 21,
    *,
    world_from_cam: Sequence[np.ndarray] | None = None,
    intrinsics: np.ndarray = INTRINSICS,
    id_size: tuple[int, int] = COLOR_SIZE,
    without_maps: Sequence[int] = (),
) -> Path:
    """One scan with .sens, both archives and aggregation.json; its folder."""
    folder = root / name
    folder.mkdir(parents=True)
    cameras = poses(num_frames) if world_from_cam is None else world_from_cam
    frames = [RecordedFrame(color(k), depth_mm(k), cameras[k]) for k in range(num_frames)]
    write_sens(folder / f"{name}.sens", frames, intrinsics)
    mapped = [k for k in range(num_frames) if k not in without_maps]
    instances = {k: id_map(k, id_size) for k in mapped}
    write_id_maps(folder / f"{name}_2d-instance-filt.zip", "instance-filt", instances)
    labels = {k: 300 * id_map(k, id_size) for k in mapped}
    write_id_maps(folder / f"{name}_2d-label-filt.zip", "label-filt", labels)
    groups = [{"id": k, "objectId": k, "label": "chair", "segments": []} for k in range(5)]
    (folder / f"{name}.aggregation.json").write_text(json.dumps({"segGroups": groups}))
    return folder


def write_processed(root: Path, name: str = "scene0000_00", num_frames: int = 4) -> Path:
    """One scan as Uni3R exports it, below root/scannet_processed."""
    folder = root / "scannet_processed" / name
    for part in ("color", "depth", "pose"):
        (folder / part).mkdir(parents=True)
    for k, pose in enumerate(poses(num_frames)):
        Image.fromarray(color(k, DEPTH_SIZE)).save(folder / "color" / f"{k:06d}.png")
        Image.fromarray(depth_mm(k)).save(folder / "depth" / f"{k:06d}.png")
        np.savez(folder / "pose" / f"{k:06d}.npz", **_cameras(pose))
    return folder


def write_lsm(root: Path, scenes: Mapping[str, Sequence[int]], *, with_list: bool = True) -> Path:
    """Scenes of these frames as in LSM's test data; the folder root/scannet_test."""
    folder = root / "scannet_test"
    for name, numbers in scenes.items():
        for part in ("images", "depths", "labels"):
            (folder / name / part).mkdir(parents=True)
        for number in numbers:
            place = folder / name
            Image.fromarray(color(number, DEPTH_SIZE)).save(
                place / "images" / f"{number}.jpg", quality=95
            )
            np.savez(place / "images" / f"{number}.npz", **_cameras(poses(number + 1)[-1]))
            Image.fromarray(depth_mm(number)).save(place / "depths" / f"{number}.png")
            labels = 300 * id_map(number, DEPTH_SIZE)
            Image.fromarray(labels).save(place / "labels" / f"{number}.png")
    if with_list:
        chosen = {name: [str(k) for k in numbers] for name, numbers in scenes.items()}
        (folder / "selected_seqs_test.json").write_text(json.dumps(chosen))
    return folder


def as_tar(folder: Path) -> Path:
    """The folder as a .tar file beside it, with its name as the first folder."""
    path = folder.with_suffix(".tar")
    with tarfile.open(path, "w") as archive:
        archive.add(folder, folder.name)
    return path


def huge_png() -> bytes:
    """A PNG whose header says 60,000 x 60,000 pixels."""
    header = b"IHDR" + struct.pack(">II5B", 60_000, 60_000, 8, 0, 0, 0, 0)
    chunk = struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))
    return b"\x89PNG\r\n\x1a\n" + chunk


def png_bytes(pixels: np.ndarray) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()


def _cameras(pose: np.ndarray) -> dict[str, np.ndarray]:
    from_centers = INTRINSICS.copy()
    from_centers[:2, 2] -= 0.5  # these files count pixels from the first one's centre
    return {"camera_pose": pose, "camera_intrinsics": from_centers}
