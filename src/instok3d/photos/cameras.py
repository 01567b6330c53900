"""Cameras of photos as other programs made them, and which photo each one belongs to."""

import os
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.checks import check_intrinsics, check_rigid
from instok3d.photos.distortion import Distortion
from instok3d.photos.file_names import loose_key, portable

MAX_DEPTH_SCALE = 1e9
"""Stored numbers in one unit, or units in one number: more is taken for damage."""


@dataclass(frozen=True)
class PhotoCamera:
    """The camera of one photo, as a file gives it. Checked and made exact by `read_cameras`."""

    name: str
    """The photo's path as the file writes it."""
    height: int
    """Of the image that the intrinsics belong to."""
    width: int
    intrinsics: Float[Tensor, "3 3"]
    """Pixels of height x width, float64."""
    cam_from_world: Float[Tensor, "4 4"]
    """OpenCV axes in the camera, the file's own world, float64."""
    distortion: Distortion = field(default_factory=Distortion)
    """What the pinhole camera leaves out."""
    depth_path: Path | None = None
    """z-depth of the same image."""
    depth_scale: float = 1000.0
    """Stored numbers in one unit of cam_from_world (1000: millimetres to metres)."""

    @property
    def distortion_shift(self) -> float:
        """How far the left out distortion moves any pixel, in image diagonals."""
        return self.distortion.largest_shift(self.intrinsics, self.height, self.width)


@dataclass(frozen=True)
class CameraSet:
    """The cameras of one file or folder, in its order."""

    cameras: tuple[PhotoCamera, ...]
    source: Path
    units: Literal["metres", "arbitrary"]

    def of(self, photos: Sequence[Path]) -> list[PhotoCamera]:
        """The camera of each photo: by the end of its path, else by its file name.

        Each first with the ending and letter case as they are, then without.

        Raises:
            ValueError: Photos have no camera (all are listed), or more than one fits.
        """
        index = _Index(self.cameras)
        found = [index.cameras_of(photo) for photo in photos]
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


class _Index:
    """Cameras by their names."""

    def __init__(self, cameras: Sequence[PhotoCamera]) -> None:
        self._by_path = {key: _grouped(cameras, key, base=False) for key in (portable, loose_key)}
        self._by_file = {key: _grouped(cameras, key, base=True) for key in (portable, loose_key)}

    def cameras_of(self, photo: Path) -> list[PhotoCamera]:
        """All that fit equally well; of paths the longest that both end in."""
        for key, table in self._by_path.items():
            parts = key(Path(os.path.abspath(photo)).as_posix()).split("/")
            for start in range(len(parts)):
                if found := table.get("/".join(parts[start:])):
                    return found
        for key, table in self._by_file.items():
            if found := table.get(_file(key(photo.name))):
                return found
        return []


def _grouped(
    cameras: Sequence[PhotoCamera], key: Callable[[str], str], *, base: bool
) -> dict[str, list[PhotoCamera]]:
    table: dict[str, list[PhotoCamera]] = defaultdict(list)
    for camera in cameras:
        name = key(camera.name)
        table[_file(name) if base else name].append(camera)
    return dict(table)


def _file(path: str) -> str:
    return path.rpartition("/")[2]


def checked_camera(camera: PhotoCamera, source: Path) -> PhotoCamera:
    """A camera that can be used, its rotation made exact.

    Raises:
        ValueError: A number of it makes no sense; the sentence names the file and the camera.
    """
    where = f"{source}: {camera.name}"
    if not camera.name.strip():
        raise ValueError(f"{source} has a camera without the name of its photo")
    cam_from_world = check_rigid(camera.cam_from_world, where=where)
    check_intrinsics(camera.intrinsics, where=where, width=camera.width, height=camera.height)
    if not camera.distortion.is_finite:
        raise ValueError(f"{where} has lens distortion that is not finite: {camera.distortion}")
    if not 1 / MAX_DEPTH_SCALE <= camera.depth_scale <= MAX_DEPTH_SCALE:
        raise ValueError(
            f"{where} has the depth scale {camera.depth_scale:g}; the depth scale must be above 0 "
            "and finite: stored numbers in one unit, such as 1000 for millimetres"
        )
    return replace(camera, cam_from_world=cam_from_world)
