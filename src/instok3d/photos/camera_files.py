"""Cameras that were made by other programs: COLMAP folders, transforms.json, scene.json.

Every foreign convention is turned into docs/conventions.md here (and in colmap_files.py).
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Float
from PIL import Image, UnidentifiedImageError
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid, rigid
from instok3d.photos import colmap_files

DISTORTION_MODELS = ("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
_OPENGL_FROM_OPENCV = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))


@dataclass(frozen=True)
class PhotoCamera:
    """The camera of one photo, as a file gives it. Checked and made exact by `read_cameras`."""

    name: str
    """The photo's path as the file writes it, with forward slashes."""
    height: int
    """Of the image that the intrinsics belong to."""
    width: int
    intrinsics: Float[Tensor, "3 3"]
    """Pixels of height x width, float64."""
    cam_from_world: Float[Tensor, "4 4"]
    """OpenCV axes in the camera, the file's own world, float64."""
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2 of OpenCV's model, which the pinhole camera leaves out."""
    depth_path: Path | None = None
    """z-depth of the same image."""
    depth_scale: float = 1000.0
    """Stored numbers in one unit of cam_from_world (1000: millimetres to metres)."""

    @property
    def distortion_shift(self) -> float:
        """How far the left out distortion moves the outermost corner, in image diagonals."""
        fx, fy = float(self.intrinsics[0, 0]), float(self.intrinsics[1, 1])
        cx, cy = float(self.intrinsics[0, 2]), float(self.intrinsics[1, 2])
        k1, k2, p1, p2 = self.distortion
        shifts = []
        for corner_x, corner_y in ((0, 0), (self.width, 0), (0, self.height)):
            x, y = (corner_x - cx) / fx, (corner_y - cy) / fy
            r2 = x * x + y * y
            radial = k1 * r2 + k2 * r2 * r2
            dx = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
            dy = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
            shifts.append(math.hypot(fx * dx, fy * dy))
        return max(shifts) / math.hypot(self.width, self.height)


@dataclass(frozen=True)
class CameraSet:
    """The cameras of one file or folder, in its order."""

    cameras: tuple[PhotoCamera, ...]
    source: Path
    units: Literal["metres", "arbitrary"]

    def of(self, photos: Sequence[Path]) -> list[PhotoCamera]:
        """The camera of each photo: by its path's end, else its file name, else name less suffix.

        Raises:
            ValueError: Photos have no camera (all are listed), or more than one fits.
        """
        found = [self._candidates(photo) for photo in photos]
        missing = [photo.name for photo, cameras in zip(photos, found, strict=True) if not cameras]
        if missing:
            some = ", ".join(camera.name for camera in self.cameras[:3])
            raise ValueError(
                f"{self.source} has no camera for {len(missing)} of {len(photos)} photos: "
                f"{', '.join(missing)} (its names are like {some}); leave these photos out or "
                "add their cameras"
            )
        for photo, cameras in zip(photos, found, strict=True):
            if len(cameras) > 1:
                raise ValueError(
                    f"{len(cameras)} cameras of {self.source} fit the photo {photo}: "
                    f"{', '.join(camera.name for camera in cameras)}; give the photos unique names"
                )
        return [cameras[0] for cameras in found]

    def _candidates(self, photo: Path) -> list[PhotoCamera]:
        path = "/" + photo.as_posix()
        same_path = [c for c in self.cameras if path.endswith("/" + c.name.removeprefix("./"))]
        same_name = [c for c in self.cameras if Path(c.name).name == photo.name]
        same_stem = [c for c in self.cameras if Path(c.name).stem == photo.stem]
        return same_path or same_name or same_stem


def read_cameras(path: str | Path) -> CameraSet:
    """The cameras of a COLMAP folder, a transforms.json, a scene.json, or a folder with one.

    Raises:
        FileNotFoundError: There is nothing at the path, or no camera file in the folder.
        ValueError: The file is damaged, lacks a field, holds a camera that is not finite, not
            rigid or mirrored, or uses a lens model that is not nearly a pinhole.
    """
    source = _camera_file(Path(path).expanduser())
    if source.is_dir():
        cameras = CameraSet(_read_colmap(source), source, "arbitrary")
    else:
        cameras = _read_json(source)
    if not cameras.cameras:
        raise ValueError(f"{source} holds no camera")
    return CameraSet(tuple(_checked(c, source) for c in cameras.cameras), source, cameras.units)


def photo_file(photo: Path) -> Path | None:
    """The file of a photo that a camera names, perhaps without its ending; None if not there."""
    candidates = [photo, *(photo.with_name(photo.name + end) for end in (".png", ".jpg"))]
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def _camera_file(path: Path) -> Path:
    if path.is_file():
        return path.parent if path.suffix in (".bin", ".txt") else path
    if not path.is_dir():
        raise FileNotFoundError(f"there is no camera file or folder {path}")
    found = [path / name for name in ("scene.json", "transforms.json") if (path / name).is_file()]
    places = (path / part for part in (".", "sparse/0", "sparse", "colmap/sparse/0", "0"))
    found += [place for place in places if colmap_files.is_model(place)][:1]
    if not found:
        raise FileNotFoundError(
            f"the folder {path} holds no cameras: wanted COLMAP's cameras and images files (there "
            "or in sparse/0), transforms.json, or scene.json"
        )
    if len(found) > 1:
        raise ValueError(
            f"the folder {path} holds several sets of cameras "
            f"({', '.join(str(f.relative_to(path)) for f in found)}); give one of them"
        )
    return found[0]


def _read_colmap(folder: Path) -> tuple[PhotoCamera, ...]:
    return tuple(
        PhotoCamera(
            name=image.name,
            height=image.camera.height,
            width=image.camera.width,
            intrinsics=_intrinsics(*_pinhole(image, folder)),
            cam_from_world=rigid(image.rotation, image.translation),
            distortion=image.camera.distortion,
        )
        for image in colmap_files.read_model(folder)
    )


def _pinhole(image: colmap_files.ColmapImage, folder: Path) -> tuple[float, float, float, float]:
    try:
        return image.camera.pinhole
    except ValueError as error:
        raise ValueError(f"{folder}, {image.name}: {error}") from error


def _read_json(path: Path) -> CameraSet:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not valid JSON ({error})") from error
    frames = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        raise ValueError(f"{path} has no list of frames; wanted transforms.json or scene.json")
    try:
        if any("c2w" in frame for frame in frames):
            return CameraSet(tuple(_scene_frame(path, data, f) for f in frames), path, "metres")
        cameras = tuple(_transforms_frame(path, {**data, **frame}) for frame in frames)
        return CameraSet(cameras, path, "arbitrary")
    except KeyError as error:
        raise ValueError(f"{path} lacks the field {error} that its frames need") from error
    except (OverflowError, ZeroDivisionError) as error:
        raise ValueError(f"{path} holds a number out of range ({error})") from error


def _scene_frame(path: Path, data: dict[str, Any], frame: dict[str, Any]) -> PhotoCamera:
    """scene.json: world_from_cam in OpenCV axes (its key is c2w), metres."""
    depth, name = frame.get("depth"), str(frame["color"])
    return PhotoCamera(
        name=name,
        height=int(_number(data, "height", path)),
        width=int(_number(data, "width", path)),
        intrinsics=_matrix(frame.get("K", data.get("K")), 3, path),
        cam_from_world=invert_rigid(
            _checked_rigid(_matrix(frame["c2w"], 4, path), f"{path}: {name}")
        ),
        depth_path=None if depth is None else path.parent / str(depth),
        depth_scale=_number(data, "depth_scale", path, 1000.0),
    )


def _transforms_frame(path: Path, frame: dict[str, Any]) -> PhotoCamera:
    """transforms.json: world_from_cam in OpenGL axes (x right, y up, z backward)."""
    model = str(frame.get("camera_model", "OPENCV"))
    if model not in DISTORTION_MODELS or frame.get("is_fisheye"):
        raise ValueError(f"{path} uses the lens model {model}; undistort the photos to PINHOLE")
    name = str(frame["file_path"])
    if "w" in frame and "h" in frame:
        height, width = int(_number(frame, "h", path)), int(_number(frame, "w", path))
    else:
        height, width = _size_of(path.parent / name, path)
    if "fl_x" in frame:
        fx = _number(frame, "fl_x", path)
    else:
        fx = 0.5 * width / math.tan(0.5 * _number(frame, "camera_angle_x", path))
    fy = _number(frame, "fl_y", path, fx)
    cx, cy = _number(frame, "cx", path, 0.5 * width), _number(frame, "cy", path, 0.5 * height)
    world_from_cam = _matrix(frame["transform_matrix"], 4, path) @ _OPENGL_FROM_OPENCV
    depth = frame.get("depth_file_path")
    k1, k2, p1, p2 = (_number(frame, key, path, 0.0) for key in ("k1", "k2", "p1", "p2"))
    return PhotoCamera(
        name=name,
        height=height,
        width=width,
        intrinsics=_intrinsics(fx, fy, cx, cy),
        cam_from_world=invert_rigid(_checked_rigid(world_from_cam, f"{path}: {name}")),
        distortion=(k1, k2, p1, p2),
        depth_path=None if depth is None else path.parent / str(depth),
        depth_scale=1.0 / _number(frame, "depth_unit_scale_factor", path, 1e-3),
    )


def _number(data: dict[str, Any], key: str, source: Path, default: float | None = None) -> float:
    value = data[key] if default is None else data.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{source}: {key} must be a number, got {value!r}")
    if not math.isfinite(value):
        raise ValueError(f"{source}: {key} must be finite, got {value}")
    return float(value)


def _size_of(photo: Path, source: Path) -> tuple[int, int]:
    file = photo_file(photo)
    if file is None:
        raise ValueError(f"{source} gives no w and h, and its photo {photo} is not there to ask")
    try:
        with Image.open(file) as image:
            return image.height, image.width
    except (UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise ValueError(f"{source} names {file}, not a usable picture") from error


def _matrix(rows: Any, size: int, path: Path) -> Float[Tensor, "{size} {size}"]:
    try:
        matrix = torch.tensor(rows, dtype=torch.float64)
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{path} has a matrix that is not {size} x {size} numbers") from error
    if matrix.shape == (3, 4) and size == 4:
        matrix = torch.cat([matrix, matrix.new_tensor([[0.0, 0.0, 0.0, 1.0]])])
    if matrix.shape != (size, size):
        raise ValueError(f"{path} has a matrix of {list(matrix.shape)}, wanted {size} x {size}")
    return matrix


def _intrinsics(fx: float, fy: float, cx: float, cy: float) -> Float[Tensor, "3 3"]:
    return torch.tensor([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]], dtype=torch.float64)


def _checked_rigid(matrix: Float[Tensor, "4 4"], what: str) -> Float[Tensor, "4 4"]:
    """The nearest exactly rigid transform, which must be near."""
    rotation, translation = matrix[:3, :3], matrix[:3, 3]
    if not matrix.isfinite().all():
        raise ValueError(f"{what} has a camera whose transform is not finite")
    if (matrix[3] - matrix.new_tensor([0.0, 0.0, 0.0, 1.0])).abs().max() > 1e-6:
        raise ValueError(f"{what} has a transform whose last row is not 0 0 0 1")
    error = (rotation @ rotation.T - torch.eye(3, dtype=matrix.dtype)).abs().max()
    if error > 5e-3:
        raise ValueError(
            f"{what} has a camera whose rotation is not orthonormal (off by {float(error):.2g})"
        )
    if torch.linalg.det(rotation) < 0:
        raise ValueError(f"{what} has a mirrored camera (its rotation is left-handed)")
    u, _, vh = torch.linalg.svd(rotation)
    return rigid(u @ vh, translation)


def _checked(camera: PhotoCamera, source: Path) -> PhotoCamera:
    matrix, name = camera.intrinsics, camera.name
    if not matrix.isfinite().all() or min(float(matrix[0, 0]), float(matrix[1, 1])) <= 0:
        raise ValueError(f"{source}: the focal length of {name} must be finite and above 0")
    if min(camera.height, camera.width) < 1 or max(camera.height, camera.width) > 10**6:
        raise ValueError(
            f"{source}: the image of {name} cannot have {camera.width} x {camera.height} pixels"
        )
    if not (0 <= matrix[0, 2] <= camera.width and 0 <= matrix[1, 2] <= camera.height):
        raise ValueError(
            f"{source}: the principal point of {name} lies outside its {camera.width} x "
            f"{camera.height} image; the intrinsics belong to another size"
        )
    if not math.isfinite(camera.depth_scale) or camera.depth_scale <= 0:
        raise ValueError(f"{source}: the depth scale must be above 0, got {camera.depth_scale}")
    _checked_rigid(camera.cam_from_world, f"{source}: {name}")
    return camera
