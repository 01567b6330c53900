"""Cameras that were made by other programs: COLMAP folders, transforms.json, scene.json.

Every foreign convention is turned into docs/conventions.md here, in camera_json.py and in
colmap_files.py.
"""

from collections import Counter
from pathlib import Path

from instok3d.geometry.cameras import rigid
from instok3d.photos import colmap_files
from instok3d.photos.camera_json import pinhole_matrix, read_camera_json
from instok3d.photos.cameras import CameraSet, PhotoCamera, checked_camera
from instok3d.photos.file_names import entry_of_any_case, given_path

CAMERA_JSON = ("scene.json", "transforms.json")


def read_cameras(path: str | Path, *, allow_outside: bool = False) -> CameraSet:
    """The cameras of a COLMAP folder, a transforms.json, a scene.json, or a folder with one.

    Of several COLMAP models in a folder the one with the most photos is taken, with a warning.

    Args:
        path: Of the file or folder.
        allow_outside: Let the file name depth pictures outside of its folder.

    Raises:
        FileNotFoundError: There is nothing at the path, or no camera file in the folder.
        ValueError: The file is damaged, lacks a field, names one photo twice, holds a camera that
            cannot be used, or uses a lens model that is not nearly a pinhole.
    """
    source = _camera_file(given_path(path))
    if source.is_dir():
        return read_colmap_cameras(source)
    return _checked(read_camera_json(source, allow_outside=allow_outside))


def read_colmap_cameras(model: Path) -> CameraSet:
    """The cameras of a COLMAP model, sorted by name.

    Args:
        model: The very folder of the cameras and images files.

    Raises:
        FileNotFoundError: The folder holds no model.
        ValueError: As for `read_cameras`.
    """
    return _checked(CameraSet(_read_colmap(model), model, "arbitrary"))


def _checked(cameras: CameraSet) -> CameraSet:
    source = cameras.source
    if not cameras.cameras:
        raise ValueError(f"{source} holds no camera")
    names = Counter(camera.name for camera in cameras.cameras)
    twice = [name for name, count in names.items() if count > 1]
    if twice:
        raise ValueError(f"{source} names {len(twice)} photos more than once, such as {twice[0]}")
    checked = tuple(checked_camera(camera, source) for camera in cameras.cameras)
    return CameraSet(checked, source, cameras.units)


def camera_files_in(folder: Path) -> list[Path]:
    """The camera files of a folder: scene.json, transforms.json, and its COLMAP model."""
    found = [file for name in CAMERA_JSON if (file := entry_of_any_case(folder, name))]
    model = colmap_files.find_model(folder)
    return [file for file in found if file.is_file()] + ([] if model is None else [model])


def _camera_file(path: Path) -> Path:
    if path.is_file():
        return path.parent if path.suffix.lower() in (".bin", ".txt") else path
    if not path.is_dir():
        raise FileNotFoundError(f"there is no camera file or folder {path}")
    found = camera_files_in(path)
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
            intrinsics=pinhole_matrix(*_pinhole(image, folder)),
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
