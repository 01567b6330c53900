"""Scenes that COLMAP made cameras for: any of them, and MipNeRF360 in its own layout."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

from instok3d.datasets.posed_photos import PhotoFiles, origin_of, prepared_photo
from instok3d.datasets.preparation import Frames, SceneJob, estimate_bytes
from instok3d.datasets.prepared import Dataset, DroppedFrame, SceneInfo, Split
from instok3d.photos import colmap_files
from instok3d.photos.camera_files import read_colmap_cameras
from instok3d.photos.file_names import IMAGE_SUFFIXES, loose_key, portable, shortened
from instok3d.photos.image_decoding import own_pixel_limit


@dataclass(frozen=True)
class ColmapSource:
    """COLMAP's scenes below a folder, or the one that it is; a `PreparationSource`.

    A scene is a folder with a sparse model (binary or text: sparse/0, sparse, or itself) and a
    folder of photos, at whatever resolution. Frames are in the order of COLMAP's image ids.
    """

    folder: Path
    """One scene, or a folder of scenes."""
    images: str = "images"
    """Name of the folder of photos in each scene."""
    size: int = 256
    """Height and width of the prepared frames."""
    split: Split = "train"
    """Which split the scenes belong to."""
    dataset: ClassVar[Dataset] = "colmap"

    def jobs(self) -> Sequence[SceneJob]:
        """All scenes, by name.

        Raises:
            FileNotFoundError: There is no such folder, or no scene in it.
        """
        if self.size < 1:
            raise ValueError(f"size must be 1 or more, got {self.size}")
        if not self.folder.is_dir():
            raise FileNotFoundError(f"there is no folder {self.folder}")
        own = _model_of(self.folder)
        if own is not None:
            return [self._job(self.folder, own)]
        folders = sorted(path for path in self.folder.iterdir() if path.is_dir())
        models = {path: model for path in folders if (model := _model_of(path)) is not None}
        if not models:
            raise FileNotFoundError(
                f"{self.folder} holds no COLMAP scene: wanted cameras and images (.bin or .txt) in "
                "sparse/0, here or in its folders"
            )
        self._warn_of_photos_alone([path for path in folders if path not in models])
        return [self._job(path, model) for path, model in models.items()]

    def _warn_of_photos_alone(self, folders: Sequence[Path]) -> None:
        alone = [folder for folder in folders if (folder / self.images).is_dir()]
        if alone:
            warnings.warn(
                f"{len(alone)} folders with photos are left out, they have no COLMAP model in "
                f"sparse/0, such as {alone[0]}",
                stacklevel=3,
            )

    def _job(self, scene: Path, model: Path | ValueError) -> SceneJob:
        photos = scene / self.images  # if it is not there, the job will say so
        there = [path for _, path in _photos_below(photos)]
        if isinstance(model, ValueError):
            origin, frames = "damaged", partial(_refuse, str(model))
        else:
            _warn_of_unnamed_photos(model, photos, there)
            origin = origin_of(there, *(f.read_bytes() for f in colmap_files.model_files(model)))
            frames = partial(colmap_frames, model, photos, self.size)
        settings = {"size": self.size, "images": self.images, "origin": origin}
        info = SceneInfo(scene.absolute().name, self.dataset, self.split, "arbitrary", settings)
        estimate = estimate_bytes(len(there), self.size, self.size, ("images",))
        return SceneJob(info, estimate, frames)


@dataclass(frozen=True)
class MipNeRF360Source(ColmapSource):
    """MipNeRF360 (`360_v2`): scenes with sparse/0 and photos reduced 4 times in images_4."""

    images: str = "images_4"
    """Name of the folder of photos in each scene."""
    split: Split = "test"
    """Which split the scenes belong to."""
    dataset: ClassVar[Dataset] = "mipnerf360"


def colmap_frames(model: Path, photos: Path, size: int) -> Frames:
    """The frames of a model, by image id; photos that are not there are dropped and counted.

    Args:
        model: Folder of COLMAP's cameras and images.
        photos: Folder that the names of the images lead from. The photos may have been reduced
            or converted: endings do not count.
        size: Height and width.

    Raises:
        FileNotFoundError: There is no such folder of photos.
        ValueError: The model is damaged, has a lens that is not nearly a pinhole, or a camera
            that does not fit its photo.
    """
    if not photos.is_dir():
        raise FileNotFoundError(f"there is no folder of photos {photos}; name it with --images")
    numbers = {image.name: image.number for image in colmap_files.read_model(model)}
    cameras = read_colmap_cameras(model).cameras
    by_name, by_key = dict(_photos_below(photos)), _by_loose_key(photos)
    with own_pixel_limit():
        for camera in sorted(cameras, key=lambda camera: numbers[camera.name]):
            exact = by_name.get(portable(camera.name))
            alike = [exact] if exact else by_key.get(loose_key(camera.name), [])
            if len(alike) > 1:
                raise ValueError(
                    f"{model} names {camera.name}, which may be "
                    f"{' or '.join(path.name for path in alike)} in {photos}; keep one"
                )
            if alike:
                yield prepared_photo(PhotoFiles(alike[0], camera.name, camera), size)
            else:
                yield DroppedFrame(camera.name, "a missing picture")


def _photos_below(folder: Path) -> list[tuple[str, Path]]:
    """Every photo and its path in the folder."""
    return [
        (path.relative_to(folder).as_posix(), path)
        for path in sorted(folder.rglob("*"))
        if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file()
    ]


def _by_loose_key(folder: Path) -> dict[str, list[Path]]:
    found: dict[str, list[Path]] = {}
    for name, path in _photos_below(folder):
        found.setdefault(loose_key(name), []).append(path)
    return found


def _warn_of_unnamed_photos(model: Path, photos: Path, there: Sequence[Path]) -> None:
    try:
        named = {loose_key(image.name) for image in colmap_files.read_model(model)}
    except ValueError:  # the job will say so
        return
    names = [path.relative_to(photos).as_posix() for path in there]
    unnamed = [name for name in names if loose_key(name) not in named]
    if unnamed:
        warnings.warn(
            f"{len(unnamed)} of {len(there)} photos in {photos} have no camera in {model} and are "
            f"left out: {shortened(unnamed)}",
            stacklevel=4,
        )


def _model_of(scene: Path) -> Path | ValueError | None:
    """The model of a scene; or why it cannot be read, for a job that fails alone."""
    try:
        return colmap_files.find_model(scene)
    except ValueError as error:
        return error


def _refuse(reason: str) -> Frames:
    raise ValueError(reason)
