"""Reading COLMAP's cameras and images, binary or text (format: COLMAP's output-format page)."""

import math
import struct
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.rotations import quat_to_matrix

# Names in the order of COLMAP's model ids, and how many parameters each has.
_MODELS = (
    ("SIMPLE_PINHOLE", 3), ("PINHOLE", 4), ("SIMPLE_RADIAL", 4), ("RADIAL", 5), ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8), ("FULL_OPENCV", 12), ("FOV", 5), ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5), ("THIN_PRISM_FISHEYE", 12), ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4), ("DIVISION", 5), ("SIMPLE_FISHEYE", 3), ("FISHEYE", 4), ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
)  # fmt: skip
_COUNTS = dict(_MODELS)


@dataclass(frozen=True)
class ColmapCamera:
    """One lens; several images may share it."""

    model: str
    height: int
    width: int
    parameters: tuple[float, ...]

    @property
    def pinhole(self) -> tuple[float, float, float, float]:
        """fx, fy, cx, cy in pixels, the centre of the top-left pixel at (0.5, 0.5)."""
        p = self.parameters
        if self.model in ("PINHOLE", "OPENCV"):
            return p[0], p[1], p[2], p[3]
        if self.model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"):
            return p[0], p[0], p[1], p[2]
        raise ValueError(
            f"COLMAP's lens model {self.model} is not supported; undistort the photos first "
            "(colmap image_undistorter)"
        )

    @property
    def distortion(self) -> tuple[float, float, float, float]:
        """k1, k2, p1, p2 of OpenCV's model."""
        p = self.parameters
        if self.model == "OPENCV":
            return p[4], p[5], p[6], p[7]
        k1 = p[3] if self.model in ("SIMPLE_RADIAL", "RADIAL") else 0.0
        return k1, p[4] if self.model == "RADIAL" else 0.0, 0.0, 0.0


@dataclass(frozen=True)
class ColmapImage:
    """One registered photo."""

    number: int
    """COLMAP's image id."""
    name: str
    rotation: Float[Tensor, "3 3"]
    """Of cam_from_world."""
    translation: Float[Tensor, " 3"]
    """Of cam_from_world."""
    camera: ColmapCamera


def is_model(folder: Path) -> bool:
    """Whether a folder holds COLMAP's cameras and images."""
    return _suffix(folder) is not None


def model_files(folder: Path) -> tuple[Path, Path]:
    """COLMAP's cameras and images files in a folder; the binary ones if both forms exist.

    Raises:
        FileNotFoundError: The folder holds no model.
    """
    suffix = _suffix(folder)
    if suffix is None:
        raise FileNotFoundError(f"{folder} lacks COLMAP's cameras and images files")
    return folder / f"cameras{suffix}", folder / f"images{suffix}"


def read_model(folder: Path) -> list[ColmapImage]:
    """The registered photos of a folder, sorted by name; the binary files are taken if both exist.

    Raises:
        FileNotFoundError: The folder holds no model.
        ValueError: A file is cut off, malformed, or an image has a camera that is not there.
    """
    cameras_file, images_file = model_files(folder)
    try:
        if cameras_file.suffix == ".bin":
            cameras = _cameras_from_bytes(cameras_file.read_bytes())
            images = _images_from_bytes(images_file.read_bytes(), cameras)
        else:
            cameras = _cameras_from_text(cameras_file.read_text(encoding="utf-8"))
            images = _images_from_text(images_file.read_text(encoding="utf-8"), cameras)
    except (struct.error, IndexError) as error:
        raise ValueError(f"the COLMAP files in {folder} are cut off; export them again") from error
    except (KeyError, ValueError) as error:
        raise ValueError(f"the COLMAP files in {folder} are damaged: {error}") from error
    return sorted(images, key=lambda image: image.name)


def _suffix(folder: Path) -> str | None:
    for suffix in (".bin", ".txt"):
        if (folder / f"cameras{suffix}").is_file() and (folder / f"images{suffix}").is_file():
            return suffix
    return None


def _cameras_from_bytes(data: bytes) -> dict[int, ColmapCamera]:
    (count,) = struct.unpack_from("<Q", data, 0)
    at, cameras = 8, {}
    for _ in range(count):
        number, model_id, width, height = struct.unpack_from("<iiQQ", data, at)
        if not 0 <= model_id < len(_MODELS):
            raise ValueError(f"unknown lens model {model_id}")
        model, length = _MODELS[model_id]
        parameters = struct.unpack_from(f"<{length}d", data, at + 24)
        cameras[number] = ColmapCamera(model, height, width, parameters)
        at += 24 + 8 * length
    return cameras


def _images_from_bytes(data: bytes, cameras: dict[int, ColmapCamera]) -> list[ColmapImage]:
    (count,) = struct.unpack_from("<Q", data, 0)
    at, images = 8, []
    for _ in range(count):
        number, *pose, camera = struct.unpack_from("<i7di", data, at)
        end = data.find(b"\0", at + 64)
        if end < 0:
            raise IndexError("a name without its end")
        name = data[at + 64 : end].decode("utf-8")
        images.append(_image(number, name, pose, camera, cameras))
        (points,) = struct.unpack_from("<Q", data, end + 1)
        at = end + 9 + 24 * points
        if at > len(data):
            raise IndexError("points beyond the end of the file")
    return images


def _cameras_from_text(text: str) -> dict[int, ColmapCamera]:
    cameras = {}
    for line in text.splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        number, model, width, height, *parameters = line.split()
        if len(parameters) != _COUNTS.get(model):
            raise ValueError(f"the lens model {model} with {len(parameters)} parameters")
        cameras[int(number)] = ColmapCamera(
            model, int(height), int(width), tuple(map(float, parameters))
        )
    return cameras


def _images_from_text(text: str, cameras: dict[int, ColmapCamera]) -> list[ColmapImage]:
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    images = []
    for line in lines[::2]:  # every second line lists 2D points and may be empty
        if not line.strip():
            continue
        number, *rest = line.split(maxsplit=9)
        pose, camera, name = [float(value) for value in rest[:7]], int(rest[7]), rest[8].strip()
        images.append(_image(int(number), name, pose, camera, cameras))
    return images


def _image(
    number: int, name: str, pose: list[float], camera: int, cameras: dict[int, ColmapCamera]
) -> ColmapImage:
    if camera not in cameras:
        raise ValueError(f"the image {name} has camera {camera}, which is not there")
    quat, translation = torch.tensor(pose, dtype=torch.float64).split([4, 3])
    if not math.isclose(float(quat.norm()), 1.0, abs_tol=1e-3):
        raise ValueError(f"the image {name} has a quaternion of length {float(quat.norm()):.3g}")
    return ColmapImage(number, name, quat_to_matrix(quat), translation, cameras[camera])
