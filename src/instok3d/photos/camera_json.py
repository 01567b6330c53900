"""Cameras of transforms.json (NeRF, nerfstudio, phones) and of scene.json (RGB-D recordings)."""

import json
import math
import reprlib
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from PIL import Image, UnidentifiedImageError
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid
from instok3d.geometry.checks import check_rigid
from instok3d.photos.cameras import CameraSet, PhotoCamera
from instok3d.photos.distortion import Distortion
from instok3d.photos.file_names import NamedFiles, read_text
from instok3d.photos.image_decoding import picture_formats

LENS_MODELS = ("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "PERSPECTIVE")
OTHER_LENS_TERMS = (
    *("k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y"),
    *("distortion", "distortion_params", "distortion_coefficients", "dist_coeffs", "is_fisheye"),
    *("latlong", "ftheta_p0", "ftheta_p1", "ftheta_p2", "ftheta_p3", "ftheta_p4"),
)
"""Refused where they are not 0: programs disagree on what they mean (k4 is a polynomial term in
nerfstudio and a denominator in OpenCV), or they make the camera no pinhole."""
MAX_NAME = 1000
"""Characters of the name of a photo or depth picture; it stands in messages."""
_OPENGL_FROM_OPENCV = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))


def read_camera_json(path: Path, *, allow_outside: bool = False) -> CameraSet:
    """The cameras of a transforms.json or a scene.json, not yet checked.

    Args:
        path: Of the file.
        allow_outside: Let it name files outside of its folder.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged, lacks a field, names a file outside of its folder, or has a
            lens that is not nearly a pinhole.
    """
    try:
        data = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not valid JSON ({error})") from error
    frames = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        raise ValueError(f"{path} has no list of frames; wanted transforms.json or scene.json")
    is_scene = any("c2w" in frame for frame in frames)
    read_frame = _scene_frame if is_scene else _transforms_frame
    files = NamedFiles(path.parent, path, allow_outside=allow_outside)
    shared = {key: value for key, value in data.items() if key != "frames"}
    try:
        cameras = tuple(read_frame(path, {**shared, **frame}, files) for frame in frames)
    except KeyError as error:
        raise ValueError(f"{path} lacks the field {error} that its frames need") from error
    except (OverflowError, ZeroDivisionError) as error:
        raise ValueError(f"{path} holds a number out of range ({error})") from error
    return CameraSet(cameras, path, "metres" if is_scene else "arbitrary")


def _scene_frame(path: Path, frame: dict[str, Any], files: NamedFiles) -> PhotoCamera:
    """scene.json: world_from_cam in OpenCV axes (its key is c2w), metres."""
    name = _name(frame, "color", path)
    _check_lens(frame, path)
    return PhotoCamera(
        name=name,
        height=_side(frame, "height", path),
        width=_side(frame, "width", path),
        intrinsics=_matrix(frame.get("K"), 3, path),
        cam_from_world=_inverse(_matrix(frame["c2w"], 4, path), path, name),
        distortion=_distortion(frame, path),
        depth_path=_depth_path(frame, "depth", path, files),
        depth_scale=_number(frame, "depth_scale", path, 1000.0),
    )


def _transforms_frame(path: Path, frame: dict[str, Any], files: NamedFiles) -> PhotoCamera:
    """transforms.json: world_from_cam in OpenGL axes (x right, y up, z backward)."""
    name = _name(frame, "file_path", path)
    _check_lens(frame, path)
    if "w" in frame and "h" in frame:
        height, width = _side(frame, "h", path), _side(frame, "w", path)
    else:
        height, width = _size_of(name, path, files)
    fx = _focal(frame, "x", width, path)
    fy = _focal(frame, "y", height, path) if {"fl_y", "camera_angle_y"} & frame.keys() else fx
    cx, cy = _number(frame, "cx", path, 0.5 * width), _number(frame, "cy", path, 0.5 * height)
    world_from_cam = _matrix(frame["transform_matrix"], 4, path) @ _OPENGL_FROM_OPENCV
    return PhotoCamera(
        name=name,
        height=height,
        width=width,
        intrinsics=pinhole_matrix(fx, fy, cx, cy),
        cam_from_world=_inverse(world_from_cam, path, name),
        distortion=_distortion(frame, path),
        depth_path=_depth_path(frame, "depth_file_path", path, files),
        depth_scale=1.0 / _number(frame, "depth_unit_scale_factor", path, 1e-3),
    )


def pinhole_matrix(fx: float, fy: float, cx: float, cy: float) -> Float[Tensor, "3 3"]:
    """K in float64."""
    return torch.tensor([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]], dtype=torch.float64)


def _focal(frame: dict[str, Any], axis: str, side: int, path: Path) -> float:
    if f"fl_{axis}" in frame:
        return _number(frame, f"fl_{axis}", path)
    angle_rad = _number(frame, f"camera_angle_{axis}", path)
    if not 0 < angle_rad < math.pi:
        raise ValueError(
            f"{path}: camera_angle_{axis} must lie between 0 and pi (radians), got {angle_rad:g}"
        )
    return 0.5 * side / math.tan(0.5 * angle_rad)


def _check_lens(frame: dict[str, Any], path: Path) -> None:
    for key in ("camera_model", "camera_type"):
        model = str(frame.get(key) or "PINHOLE")
        if model.upper() not in LENS_MODELS:
            raise ValueError(
                f"{path} uses the lens model {model[:60]}; undistort the photos to PINHOLE"
            )
    for key in OTHER_LENS_TERMS:
        if not _is_nothing(frame.get(key)):
            raise ValueError(
                f"{path} has the lens term {key}, which is not read; undistort the photos"
            )


def _is_nothing(value: Any) -> bool:
    """Whether a field of a lens says that there is no such term."""
    if isinstance(value, dict):
        return all(map(_is_nothing, value.values()))
    if isinstance(value, list):
        return all(map(_is_nothing, value))
    return value is None or value == 0


def _distortion(frame: dict[str, Any], path: Path) -> Distortion:
    terms = {key: _number(frame, key, path, 0.0) for key in ("k1", "k2", "p1", "p2", "k3")}
    return Distortion(**terms)


def _depth_path(frame: dict[str, Any], key: str, path: Path, files: NamedFiles) -> Path | None:
    return None if frame.get(key) is None else files.place(_name(frame, key, path))


def _name(frame: dict[str, Any], key: str, source: Path) -> str:
    name = frame[key]
    if not isinstance(name, str) or not name.strip() or "\0" in name or len(name) > MAX_NAME:
        raise ValueError(f"{source}: {key} must be the name of a file, got {reprlib.repr(name)}")
    return name


def _number(data: dict[str, Any], key: str, source: Path, default: float | None = None) -> float:
    value = data[key] if default is None else data.get(key)
    if value is None and default is not None:
        return default
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{source}: {key} must be a number, got {reprlib.repr(value)}")
    if not math.isfinite(value):
        raise ValueError(f"{source}: {key} must be finite, got {value}")
    return float(value)


def _side(data: dict[str, Any], key: str, source: Path) -> int:
    value = _number(data, key, source)
    if value != int(value):
        raise ValueError(f"{source}: {key} must be a whole number of pixels, got {value}")
    return int(value)


def _size_of(name: str, source: Path, files: NamedFiles) -> tuple[int, int]:
    file = files.photo(name)
    if file is None:
        raise ValueError(
            f"{source} gives no w and h, and its photo {files.place(name)} is not there to ask"
        )
    try:
        with Image.open(file, formats=picture_formats()) as image:
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


def _inverse(world_from_cam: Float[Tensor, "4 4"], path: Path, name: str) -> Float[Tensor, "4 4"]:
    return invert_rigid(check_rigid(world_from_cam, where=f"{path}: {name}"))
