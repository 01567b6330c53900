"""Own footage: photos or a video, with id maps and cameras where they are known, as a scene."""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from instok3d.datasets.posed_photos import PhotoFiles, origin_of, prepared_photo
from instok3d.datasets.preparation import SceneJob, estimate_bytes
from instok3d.datasets.prepared import PreparedFrame, SceneInfo, Split
from instok3d.photos.cameras import CameraSet
from instok3d.photos.captures import find_photos_and_cameras
from instok3d.photos.depth_checks import check_depth, read_depth_views
from instok3d.photos.file_names import given_path
from instok3d.photos.image_decoding import own_pixel_limit


@dataclass(frozen=True)
class FootageSource:
    """A folder of photos of one scene, in the order of their names; a `PreparationSource`.

    A scene without cameras serves for masks (`instok3d data masks`) but not for training.
    """

    folder: Path
    """Of photos; or a video, or a folder with photos and cameras as scanners leave them."""
    masks: Path | None = None
    """Folder of id maps: NAME.png of 8 or 16 bits for each photo NAME.*, of its size; 0 = none."""
    cameras: Path | None = None
    """COLMAP folder, transforms.json, or scene.json (with depth); every photo must be there."""
    allow_outside: bool = False
    """Open photos and depth that the camera file names outside of its folder."""
    name: str | None = None
    """Of the scene; that of the folder if not given. Scenes of one folder need different names."""
    size: int = 256
    """Height and width of the prepared frames."""
    split: Split = "train"
    """Which split the scene belongs to."""

    def jobs(self) -> Sequence[SceneJob]:
        """The one scene.

        Raises:
            FileNotFoundError: Something named is not there, or a photo has no id map.
            ValueError: No photo is there, or a photo has no camera.
        """
        if self.size < 1:
            raise ValueError(f"size must be 1 or more, got {self.size}")
        photos, cameras = find_photos_and_cameras(
            self.folder, self.cameras, allow_outside=self.allow_outside
        )
        files = photo_files(photos, cameras, self.masks)
        layers = ["images"]
        layers += ["depths"] * files[0].with_depth + ["instances"] * (self.masks is not None)
        settings = {"size": self.size, "layers": layers, "cameras": cameras is not None,
                    "origin": _origin(files)}  # fmt: skip
        unit = "metre" if cameras is not None and cameras.units == "metres" else "arbitrary"
        place = given_path(self.folder).absolute()
        name = self.name or (place.name if place.is_dir() else place.stem)
        info = SceneInfo(name, "footage", self.split, unit, settings)
        estimate = estimate_bytes(len(files), self.size, self.size, layers)
        return [SceneJob(info, estimate, partial(_frames, files, self.size))]


def _origin(files: Sequence[PhotoFiles]) -> str:
    maps = [file.ids for file in files if isinstance(file.ids, Path)]
    cameras = [file.camera for file in files if file.camera is not None]
    numbers = [(c.intrinsics.tolist(), c.cam_from_world.tolist()) for c in cameras]
    return origin_of([file.photo for file in files] + maps, repr(numbers).encode())


def photo_files(
    photos: Sequence[Path], cameras: CameraSet | None, masks: Path | None = None
) -> list[PhotoFiles]:
    """The files of each photo: its camera, depth in metres and id map, where they are known.

    Raises:
        FileNotFoundError: A photo has no id map.
        ValueError: A photo has no camera, or names of photos differ in their ending alone.
    """
    known = [None] * len(photos) if cameras is None else cameras.of(photos)
    has_depth = any(camera is not None and camera.depth_path is not None for camera in known)
    if has_depth and cameras is not None and cameras.units != "metres":
        warnings.warn(
            f"the depth that {cameras.source} names is left out: its unit is not known",
            stacklevel=3,
        )
        has_depth = False
    ids = [None] * len(photos) if masks is None else _id_maps(photos, masks)
    return [
        PhotoFiles(photo, photo.name, camera, id_map, has_depth)
        for photo, camera, id_map in zip(photos, known, ids, strict=True)
    ]


def _id_maps(photos: Sequence[Path], masks: Path) -> list[Path]:
    if not masks.is_dir():
        raise FileNotFoundError(f"there is no folder of id maps {masks}")
    found = {path.stem: path for path in masks.glob("[!.]*.png") if path.is_file()}
    missing = [photo.name for photo in photos if photo.stem not in found]
    if missing:
        raise FileNotFoundError(
            f"{masks} has no id map for {len(missing)} of {len(photos)} photos, such as "
            f"{missing[0]} (wanted {Path(missing[0]).stem}.png)"
        )
    stems = [photo.stem for photo in photos]
    if len(set(stems)) < len(stems):
        raise ValueError(f"photos of {photos[0].parent} differ only in ending; id maps need names")
    if len(found) > len(photos):
        warnings.warn(
            f"{len(found) - len(photos)} of {len(found)} id maps in {masks} belong to no photo",
            stacklevel=4,
        )
    return [found[stem] for stem in stems]


def _frames(files: Sequence[PhotoFiles], size: int) -> Iterator[PreparedFrame]:
    check_metric_depth(files)
    with own_pixel_limit():
        for file in files:
            yield prepared_photo(file, size)


def check_metric_depth(files: Sequence[PhotoFiles]) -> None:
    """Refuse depth in another unit than metres, that of the cameras, before a frame is written.

    Raises:
        ValueError: It is, or there is none in the depth pictures.
    """
    cameras = [file.camera for file in files if file.camera is not None and file.with_depth]
    for note in check_depth(read_depth_views(cameras), metric=True):
        warnings.warn(note, stacklevel=3)
