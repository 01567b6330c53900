"""Reading COLMAP's cameras and images, binary or text (format: COLMAP's output-format page)."""

import math
import os
import re
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.rotations import quat_to_matrix
from instok3d.photos.distortion import Distortion
from instok3d.photos.file_names import entry_of_any_case, read_text, shortened
from instok3d.reading import naming_damage

REMEDY = "export it again from COLMAP"
Item = TypeVar("Item")

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
    def distortion(self) -> Distortion:
        """Of the models that `pinhole` supports."""
        first = {"SIMPLE_RADIAL": 3, "RADIAL": 3, "OPENCV": 4}.get(self.model)
        return Distortion() if first is None else Distortion(*self.parameters[first:])


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


def find_model(folder: Path) -> Path | None:
    """Where a folder holds COLMAP's cameras and images: there, in sparse, sparse/0, sparse/1, ...

    COLMAP writes one model for each part of the photos that hangs together. The one with the most
    photos is taken, and a warning says which others there are and how many photos only they have.

    Returns:
        The model's folder, or None if there is no model.

    Raises:
        ValueError: There are several models and one of them is damaged.
    """
    models = [place for place in _places(folder) if holds_model(place)]
    if len(models) < 2:
        return models[0] if models else None
    names = {model: {image.name for image in read_model(model)} for model in models}
    largest = max(models, key=lambda model: len(names[model]))  # the first of equals
    lost = set().union(*names.values()) - names[largest]
    listed = ", ".join(f"{_relative(m, folder)} with {len(names[m])} photos" for m in models)
    left_out = f", which leaves out {len(lost)} photos: {shortened(sorted(lost))}" if lost else ""
    warnings.warn(
        f"{folder} holds {len(models)} COLMAP models ({listed}); "
        f"{_relative(largest, folder)} is used{left_out}",
        stacklevel=2,
    )
    return largest


def holds_model(folder: Path) -> bool:
    """Whether COLMAP's cameras and images lie in this very folder."""
    return _suffix(folder) is not None


def model_files(folder: Path) -> tuple[Path, Path]:
    """COLMAP's cameras and images files in a folder; the binary ones if both forms exist.

    Letter case does not count: RealityCapture writes Cameras.txt.

    Raises:
        FileNotFoundError: The folder holds no model.
    """
    suffix = _suffix(folder)
    if suffix is None:
        raise FileNotFoundError(f"{folder} lacks COLMAP's cameras and images files")
    cameras, images = (entry_of_any_case(folder, name + suffix) for name in ("cameras", "images"))
    assert cameras is not None
    assert images is not None
    return cameras, images


def read_model(folder: Path) -> list[ColmapImage]:
    """The registered photos of a folder, sorted by name; the binary files are taken if both exist.

    Raises:
        FileNotFoundError: The folder holds no model.
        ValueError: A file is cut off, malformed, or an image has a camera that is not there.
    """
    cameras_file, images_file = model_files(folder)
    is_binary = _suffix(folder) == ".bin"
    with naming_damage(cameras_file, REMEDY), _ends_early():
        if is_binary:
            cameras = _cameras_from_bytes(cameras_file.read_bytes())
        else:
            cameras = _cameras_from_text(read_text(cameras_file))
    with naming_damage(images_file, REMEDY), _ends_early():
        if is_binary:
            images = _images_from_bytes(images_file.read_bytes(), cameras)
        else:
            images = _images_from_text(read_text(images_file), cameras)
    return sorted(images, key=lambda image: image.name)


@contextmanager
def _ends_early() -> Iterator[None]:
    try:
        yield
    except (struct.error, IndexError) as error:
        raise ValueError("it is cut off") from error


def _places(folder: Path) -> list[Path]:
    """Folders that may hold a model, those that COLMAP itself writes first."""
    places: list[Path] = []
    for part in ("sparse", "colmap/sparse", "."):
        parent: Path | None = folder
        for name in part.split("/"):
            parent = None if parent is None else entry_of_any_case(parent, name)
        if parent is not None and parent.is_dir():
            numbered = [entry for entry in parent.iterdir() if entry.name.isdecimal()]
            places += [*sorted(numbered, key=lambda entry: int(entry.name)), parent]
    return [place for place in places if place.is_dir()]


def _relative(place: Path, folder: Path) -> str:
    return place.relative_to(folder).as_posix()


def _suffix(folder: Path) -> str | None:
    for suffix in (".bin", ".txt"):
        files = [entry_of_any_case(folder, name + suffix) for name in ("cameras", "images")]
        if all(file is not None and file.is_file() for file in files):
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
        _add(cameras, number, ColmapCamera(model, height, width, parameters))
        at += 24 + 8 * length
    _check_end(data, at, f"{count} cameras")
    return cameras


def _images_from_bytes(data: bytes, cameras: dict[int, ColmapCamera]) -> list[ColmapImage]:
    (count,) = struct.unpack_from("<Q", data, 0)
    at, images = 8, {}
    for _ in range(count):
        number, *pose, camera = struct.unpack_from("<i7di", data, at)
        end = data.find(b"\0", at + 64)
        if end < 0:
            raise IndexError("a name without its end")
        name = os.fsdecode(data[at + 64 : end])
        _add(images, number, _image(number, name, pose, camera, cameras))
        (points,) = struct.unpack_from("<Q", data, end + 1)
        at = end + 9 + 24 * points
        if at > len(data):
            raise IndexError("points beyond the end of the file")
    _check_end(data, at, f"{count} images")
    return list(images.values())


def _check_end(data: bytes, at: int, what: str) -> None:
    if at != len(data):
        raise ValueError(f"{len(data) - at} bytes follow the {what} that the file promises")


def _cameras_from_text(text: str) -> dict[int, ColmapCamera]:
    cameras: dict[int, ColmapCamera] = {}
    for line in _lines(text):
        if not line:
            continue
        number, model, width, height, *parameters = line.split()
        if len(parameters) != _COUNTS.get(model):
            raise ValueError(f"the lens model {model} with {len(parameters)} parameters")
        camera = ColmapCamera(model, int(height), int(width), tuple(map(float, parameters)))
        _add(cameras, int(number), camera)
    _check_promise(text, len(cameras), "cameras")
    return cameras


def _images_from_text(text: str, cameras: dict[int, ColmapCamera]) -> list[ColmapImage]:
    """A line for each image; then one that lists its 2D points, which may be empty or not there.

    The two kinds cannot be taken for each other: points are triples of x, y and a whole number,
    a line of an image ends in a name.
    """
    images: dict[int, ColmapImage] = {}
    may_be_points = False
    for line in _lines(text):
        if not line or (may_be_points and _is_points(line)):
            may_be_points = False
            continue
        try:
            number, *rest = line.split(maxsplit=9)
            pose, camera, name = [float(value) for value in rest[:7]], int(rest[7]), rest[8]
            _add(images, int(number), _image(int(number), name, pose, camera, cameras))
        except IndexError as error:
            raise ValueError(f"the line {line[:60]!r} is neither an image nor points") from error
        may_be_points = True
    _check_promise(text, len(images), "images")
    return list(images.values())


def _lines(text: str) -> list[str]:
    """Without comments; other characters that Python takes for line ends may be in names."""
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return [line.strip(" \t") for line in lines if not line.lstrip().startswith("#")]


def _is_points(line: str) -> bool:
    words = line.split()
    first = words[:30]  # enough to tell, and lines are long
    whole = all(word.lstrip("-").isdecimal() for word in first[2::3])
    return len(words) % 3 == 0 and whole and all(map(_is_number, first))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _check_promise(text: str, count: int, what: str) -> None:
    """COLMAP writes how many there are into a comment, which reveals a truncated file."""
    promised = re.search(rf"^#\s*Number of {what}: (\d+)", text, re.MULTILINE)
    if promised is not None and count < int(promised[1]):
        raise ValueError(f"it says that it holds {promised[1]} {what}, but lists {count}")


def _add(items: dict[int, Item], number: int, item: Item) -> None:
    if number in items:
        raise ValueError(f"the number {number} is used twice")
    items[number] = item


def _image(
    number: int, name: str, pose: list[float], camera: int, cameras: dict[int, ColmapCamera]
) -> ColmapImage:
    if camera not in cameras:
        raise ValueError(f"the image {name} has camera {camera}, which is not there")
    quat, translation = torch.tensor(pose, dtype=torch.float64).split([4, 3])
    if not math.isclose(float(quat.norm()), 1.0, abs_tol=1e-3):
        raise ValueError(f"the image {name} has a quaternion of length {float(quat.norm()):.3g}")
    return ColmapImage(number, name, quat_to_matrix(quat), translation, cameras[camera])
