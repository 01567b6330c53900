"""Every format that holds cameras: a sound file of it but for one camera, and what reads it."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from safetensors.torch import save_file

from colmap_models import write_colmap
from instok3d.data.sample import Sample
from instok3d.datasets.prepared import PreparedScenes
from instok3d.datasets.re10k import Re10kSource
from instok3d.datasets.scannet.export import scan_frames
from instok3d.datasets.scannet.exported import lsm_frames, processed_frames
from instok3d.files import write_json
from instok3d.photos.camera_files import read_cameras
from instok3d.rooms import RoomDataset
from instok3d.rooms.shards import new_index
from instok3d.scene.files import load_record
from instok3d.scene.paths import read_camera_path
from instok3d.training.cache.features import FeatureCache
from instok3d.types import Views
from made_scene import HEIGHT, WIDTH, made_scene, made_tokens
from noise_rooms import noise_scene, put
from prepared_scenes import made_folder
from scannet_files import write_lsm, write_processed, write_scan

SCAN = "scene0000_00"
SOUND = np.eye(4)


@dataclass(frozen=True)
class Camera:
    """What a file says of one camera, in the three forms that formats have."""

    pose: np.ndarray
    """4 x 4, either way round."""
    numbers: list[float]
    """The pose as a quaternion wxyz and a translation, as COLMAP has it."""
    intrinsics: np.ndarray
    """3 x 3, in pixels of a picture of unit size: 1 for the focal lengths, 0.5 for the middle."""

    def of(self, width: float, height: float) -> np.ndarray:
        """The intrinsics in pixels of such a picture; the focal lengths are its width."""
        scaled = self.intrinsics.copy()
        with np.errstate(invalid="ignore"):
            scaled[0] *= width
            scaled[1, :2] *= width
            scaled[1, 2] *= height
        return scaled


def sound_camera() -> Camera:
    intrinsics = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    return Camera(np.eye(4), [1.0, 0, 0, 0, 0, 0, 0], intrinsics)


@dataclass(frozen=True)
class Written:
    """A file, and what reads it."""

    file: Path
    read: Callable[[], object]


def scene_folder(folder: Path, camera: Camera) -> Written:
    made_scene(made_tokens()).save(folder / "room.itk")
    file = folder / "room.itk" / "cameras.json"
    entries = json.loads(file.read_text())
    entries[1] |= {"cam_from_world": camera.pose.tolist(),
                   "intrinsics": camera.of(WIDTH, HEIGHT).tolist()}  # fmt: skip
    file.write_text(json.dumps(entries))
    return Written(file, lambda: load_record(folder / "room.itk"))


def camera_path(folder: Path, camera: Camera) -> Written:
    cameras = [sound_camera(), camera]
    entries = [
        {"cam_from_world": each.pose.tolist(), "intrinsics": each.of(32, 24).tolist(),
         "height": 24, "width": 32}
        for each in cameras
    ]  # fmt: skip
    file = folder / "path.json"
    file.write_text(json.dumps(entries))
    return Written(file, lambda: read_camera_path(file))


def rooms(folder: Path, camera: Camera) -> Written:
    scene = noise_scene(4)
    poses, intrinsics = scene.world_from_cam.copy(), scene.intrinsics.copy()
    poses[5], intrinsics[5] = camera.pose, camera.of(16, 16)
    write_json(folder / "rooms.json", new_index(16, "mix"))
    put(folder, 0, [replace(scene, world_from_cam=poses, intrinsics=intrinsics)])
    file = folder / "rooms-0000000.safetensors"
    return Written(file, lambda: RoomDataset(folder).frames(0, [0]))


def prepared(folder: Path, camera: Camera) -> Written:
    made_folder(folder, {"a": "train"}, num_frames=2)
    file = folder / "a" / "scene.json"
    record = json.loads(file.read_text())
    record["frames"][1] |= {"world_from_cam": camera.pose.tolist(),
                            "intrinsics": camera.of(8, 6).tolist()}  # fmt: skip
    file.write_text(json.dumps(record))
    return Written(file, lambda: PreparedScenes(folder).frames(0, [0]))


def feature_cache(folder: Path, camera: Camera, **changed: torch.Tensor) -> Written:
    (folder / "scenes").mkdir(parents=True)
    settings = {
        "backbone": {}, "backbone_sha256": "ab" * 32, "patch_size": 8, "feature_channels": 4,
        "inputs": ["photos"], "dtype": "float16", "amp": False, "seed": 0,
        "batches": {"views": [2], "samples_per_scene": 1}, "validation_views": [2],
    }  # fmt: skip
    index = {"format": "instok3d-features-1", "settings": settings,
             "training": ["room"], "held_out": []}  # fmt: skip
    (folder / "features.json").write_text(json.dumps(index))
    cameras = [sound_camera(), camera]
    answer = {
        "features": torch.zeros(2, 4, 4), "depths": torch.ones(2, 16, 16),
        "confidences": torch.ones(2, 16, 16),
        "cam_from_world": torch.tensor(np.stack([each.pose for each in cameras])).float(),
        "intrinsics": torch.tensor(np.stack([each.of(16, 16) for each in cameras])).float(),
    } | changed  # fmt: skip
    file = folder / "scenes" / "room.safetensors"
    save_file({f"2/0/photos/{name}": value for name, value in answer.items()}, file)
    views, ids = Views(torch.rand(1, 2, 3, 16, 16)), torch.zeros(1, 2, 16, 16, dtype=torch.long)
    sample = Sample(views, views, ids, ids, ("room",), keys=("room/2/0",))
    return Written(
        file, lambda: FeatureCache(folder).geometry(sample, given=False, intrinsics=False)
    )


def colmap_text(folder: Path, camera: Camera) -> Written:
    return _colmap(folder, camera, ".txt")


def colmap_binary(folder: Path, camera: Camera) -> Written:
    return _colmap(folder, camera, ".bin")


def _colmap(folder: Path, camera: Camera, suffix: str) -> Written:
    lenses = {}
    for number, each in enumerate([sound_camera(), camera], start=1):
        k = each.of(64, 48)
        lenses[number] = ("PINHOLE", 64, 48, [float(k[at]) for at in [(0, 0), (1, 1), (0, 2),
                                                                      (1, 2)]])  # fmt: skip
    images = [("0.jpg", sound_camera().numbers, 1), ("1.jpg", camera.numbers, 2)]
    write_colmap(folder / "model", lenses, images, suffix)
    return Written(folder / "model", lambda: read_cameras(folder / "model"))


def transforms_json(folder: Path, camera: Camera) -> Written:
    frames = []
    for number, each in enumerate([sound_camera(), camera]):
        k = each.of(64, 48)
        frames.append({"file_path": f"{number}.jpg", "transform_matrix": each.pose.tolist(),
                       "w": 64, "h": 48, "fl_x": k[0, 0], "fl_y": k[1, 1], "cx": k[0, 2],
                       "cy": k[1, 2]})  # fmt: skip
    file = folder / "transforms.json"
    file.write_text(json.dumps({"frames": frames}))
    return Written(file, lambda: read_cameras(file))


def scene_json(folder: Path, camera: Camera) -> Written:
    frames = [
        {"color": f"{number}.jpg", "c2w": each.pose.tolist(), "K": each.of(64, 48).tolist(),
         "width": 64, "height": 48}
        for number, each in enumerate([sound_camera(), camera])
    ]  # fmt: skip
    file = folder / "scene.json"
    file.write_text(json.dumps({"frames": frames}))
    return Written(file, lambda: read_cameras(file))


def sens(folder: Path, camera: Camera) -> Written:
    intrinsics = camera.of(64, 48)
    file = write_scan(
        folder, num_frames=2, world_from_cam=[SOUND, camera.pose], intrinsics=intrinsics
    )
    file = file / f"{SCAN}.sens"
    return Written(file, lambda: list(scan_frames(file, stride=1, size=24)))


def scannet_processed(folder: Path, camera: Camera) -> Written:
    file = write_processed(folder, num_frames=2) / "pose" / "000001.npz"
    _change_npz(file, camera)
    root = folder / "scannet_processed"
    return Written(file, lambda: list(processed_frames(root, SCAN, size=24)))


def scannet_lsm(folder: Path, camera: Camera) -> Written:
    root = write_lsm(folder, {SCAN: (0, 1)})
    file = root / SCAN / "images" / "1.npz"
    _change_npz(file, camera)
    return Written(file, lambda: list(lsm_frames(root, SCAN, None, size=24)))


def _change_npz(file: Path, camera: Camera) -> None:
    intrinsics = camera.of(64, 48)
    intrinsics[:2, 2] -= 0.5
    np.savez(file, camera_pose=camera.pose, camera_intrinsics=intrinsics)


def re10k_text(folder: Path, camera: Camera) -> Written:
    lines, frames = ["an address"], folder / "images" / "test" / "clip"
    frames.mkdir(parents=True)
    (folder / "test").mkdir()
    for number, each in enumerate([sound_camera(), camera]):
        k = each.of(1, 1)
        shares = [k[0, 0], k[1, 1] * 640 / 360, k[0, 2], k[1, 2], 0.0, 0.0]
        lines.append(" ".join(map(repr, map(float, [number, *shares, *each.pose[:3].ravel()]))))
        lines[-1] = f"{number} {lines[-1].split(' ', 1)[1]}"
        Image.new("RGB", (640, 360)).save(frames / f"{number}.jpg")
    file = folder / "test" / "clip.txt"
    file.write_text("\n".join(lines) + "\n")
    (job,) = Re10kSource(folder, images=folder / "images").jobs()
    return Written(file, lambda: list(job.frames()))


READERS: dict[str, Callable[[Path, Camera], Written]] = {
    each.__name__: each
    for each in (
        scene_folder, camera_path, rooms, prepared, feature_cache, colmap_text, colmap_binary,
        transforms_json, scene_json, sens, scannet_processed, scannet_lsm, re10k_text,
    )
}  # fmt: skip
