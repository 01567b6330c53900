"""Folders that hold their photos with cameras beside them, as COLMAP and scanners leave them."""

import os
import warnings
from collections.abc import Sequence
from pathlib import Path

from instok3d.photos.camera_files import CAMERA_JSON, read_cameras
from instok3d.photos.cameras import CameraSet
from instok3d.photos.colmap_files import holds_model
from instok3d.photos.file_names import NamedFiles, entry_of_any_case, given_path, shortened
from instok3d.photos.image_files import NoPhotosError, find_images, is_photo


def find_photos_and_cameras(
    source: str | Path | Sequence[str | Path],
    cameras: str | Path | None = None,
    *,
    allow_outside: bool = False,
) -> tuple[list[Path], CameraSet | None]:
    """The photos that `source` stands for, and their cameras where they are known.

    What `find_images` finds. Only where that is a folder without photos of its own, or a .json
    file, the photos are those that the cameras name; then the cameras too come from there unless
    they are given. Photos beside them that the cameras do not name are left out with a warning.

    Args:
        source: As for `find_images`; or a folder with a camera file and its photos in subfolders;
            or a transforms.json or scene.json.
        cameras: As for `read_cameras`.
        allow_outside: Let a camera file name photos and depth outside of its folder.

    Raises:
        FileNotFoundError: Something named is not there, such as a photo that a camera names.
        PermissionError: A folder may not be listed.
        ValueError: No photo is there, or the cameras cannot be used.
    """
    known = None if cameras is None else read_cameras(cameras, allow_outside=allow_outside)
    place = given_path(source) if isinstance(source, str | Path) else None
    if place is not None and place.suffix.lower() == ".json" and place.is_file():
        known = known or read_cameras(place, allow_outside=allow_outside)
        return _photos_of(known, place.parent, allow_outside=allow_outside), known
    try:
        photos = find_images(source)
    except NoPhotosError as error:
        if place is None or not place.is_dir():
            raise
        try:
            known = known or read_cameras(place, allow_outside=allow_outside)
        except FileNotFoundError:
            raise error from None  # its sentence says what else may be given
        return _photos_of(known, place, allow_outside=allow_outside), known
    if known is None and place is not None and place.is_dir():
        _tell_unused_cameras(place)
    return photos, known


def _tell_unused_cameras(folder: Path) -> None:
    beside = [file for name in CAMERA_JSON if (file := entry_of_any_case(folder, name))]
    beside += [place for place in (folder / "sparse/0", folder / "sparse", folder)
               if holds_model(place)][:1]  # fmt: skip
    if beside:
        warnings.warn(
            f"the cameras in {beside[0]} are not used, because {folder} holds photos itself; pass "
            f"--cameras {beside[0]} to use them",
            stacklevel=3,
        )


def _photos_of(cameras: CameraSet, folder: Path, *, allow_outside: bool) -> list[Path]:
    """In the cameras' order; COLMAP names its photos below a folder images."""
    places = [
        NamedFiles(place, cameras.source, allow_outside=allow_outside)
        for place in (folder, folder / "images")
    ]
    photos = []
    for camera in cameras.cameras:
        found = next(filter(None, (place.photo(camera.name) for place in places)), None)
        if found is None:
            raise FileNotFoundError(
                f"{cameras.source} names the photo {camera.name}, which is not in {folder}; give "
                "the folder with the photos, and the cameras by --cameras"
            )
        photos.append(found)
    _tell_unnamed_photos(cameras, folder, photos)
    return photos


def _tell_unnamed_photos(cameras: CameraSet, folder: Path, photos: Sequence[Path]) -> None:
    """Photos without a camera in the folders of those that have one, such as COLMAP's images."""
    depths = [camera.depth_path for camera in cameras.cameras if camera.depth_path is not None]
    used = {os.path.realpath(path) for path in (*photos, *depths)}
    others = sorted(
        path.relative_to(folder).as_posix()
        for name in {_first_part(photo, folder) for photo in photos}
        for path in (folder.iterdir() if name == "." else (folder / name).rglob("*"))
        if name != ".." and is_photo(path) and os.path.realpath(path) not in used
    )
    if others:
        warnings.warn(
            f"{len(others)} of {len(others) + len(photos)} photos in {folder} have no camera in "
            f"{cameras.source} and were left out: {shortened(others)}",
            stacklevel=4,
        )


def _first_part(photo: Path, folder: Path) -> str:
    """The folder in `folder` that the photo lies below; "." if it lies there, ".." if elsewhere."""
    parts = Path(os.path.relpath(photo, folder)).parts
    return "." if len(parts) == 1 else parts[0]
