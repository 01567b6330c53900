"""Folders that hold their photos with cameras beside them, as COLMAP and scanners leave them."""

from collections.abc import Sequence
from pathlib import Path

from instok3d.photos.camera_files import CameraSet, photo_file, read_cameras
from instok3d.photos.image_files import NoPhotosError, find_images


def find_photos_and_cameras(
    source: str | Path | Sequence[str | Path], cameras: str | Path | None = None
) -> tuple[list[Path], CameraSet | None]:
    """The photos that `source` stands for, and their cameras where they are known.

    What `find_images` finds. Only where that is a folder without photos of its own, or a .json
    file, the photos are those that the cameras name; then the cameras too come from there unless
    they are given.

    Args:
        source: As for `find_images`; or a folder with a camera file and its photos in subfolders;
            or a transforms.json or scene.json.
        cameras: As for `read_cameras`.

    Raises:
        FileNotFoundError: Something named is not there, such as a photo that a camera names.
        PermissionError: A folder may not be listed.
        ValueError: No photo is there, or the cameras cannot be used.
    """
    known = None if cameras is None else read_cameras(cameras)
    place = Path(source).expanduser() if isinstance(source, str | Path) else None
    if place is not None and place.suffix.lower() == ".json" and place.is_file():
        known = known or read_cameras(place)
        return _photos_of(known, place.parent), known
    try:
        return find_images(source), known
    except NoPhotosError as error:
        if place is None or not place.is_dir():
            raise
        try:
            known = known or read_cameras(place)
        except FileNotFoundError:
            raise error from None  # its sentence says what else may be given
        return _photos_of(known, place), known


def _photos_of(cameras: CameraSet, folder: Path) -> list[Path]:
    """In the cameras' order; COLMAP names its photos below a folder images."""
    photos = []
    for camera in cameras.cameras:
        found = photo_file(folder / camera.name) or photo_file(folder / "images" / camera.name)
        if found is None:
            raise FileNotFoundError(
                f"{cameras.source} names the photo {camera.name}, which is not in {folder}; give "
                "the folder with the photos, and the cameras by --cameras"
            )
        photos.append(found)
    return photos
