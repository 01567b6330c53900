"""RealEstate10K: clips in .torch chunks (pixelSplat's form) or camera text files with frames.

Cameras are normalised intrinsics fx, fy, cx, cy, two zeros, and cam_from_world as 3 x 4 rows;
their unit of length is arbitrary and another in every clip. Prepared frames are named by their
number in the clip, which is what the evaluation index counts in.
"""

import io
import math
import pickle
import reprlib
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Literal, NoReturn

import numpy as np
import torch
from jaxtyping import Bool, Float
from PIL import Image

from instok3d.datasets.poses import pose_fault
from instok3d.datasets.preparation import Frames, LeftOutError, SceneJob, estimate_bytes
from instok3d.datasets.prepared import DroppedFrame, PreparedFrame, SceneInfo
from instok3d.datasets.prepared.format import can_name_a_scene
from instok3d.geometry.cameras import invert_rigid
from instok3d.geometry.checks import FOCAL_RANGE
from instok3d.photos.cropping import crop_image
from instok3d.photos.image_decoding import naming_damage
from instok3d.photos.pixel_map import PixelMap, fit_pixels
from instok3d.reading import UNREADABLE, read_json, reason_of

HEIGHT, WIDTH = 360, 640
"""Of the frames that pixelSplat and its followers use; clips of other sizes are left out."""
MAX_FIELD_OF_VIEW_RAD = math.radians(100)
"""Clips with a wider camera are left out (pixelSplat): their intrinsics are wrong."""
_FRAME_BYTES = 45_000  # of a JPEG of 640 x 360
_CLIP_FRAMES = 150
_PARTS = ("train", "test")
_IMAGE_ENDINGS = (".jpg", ".png", ".jpeg")


@dataclass(frozen=True)
class Re10kClip:
    """One clip as it is stored."""

    key: str
    source: Path
    """The chunk or camera file."""
    cameras: Float[np.ndarray, "frame 18"]
    images: Sequence[bytes | Path]
    """JPEG or PNG of each frame: its bytes, or the file."""


@dataclass(frozen=True)
class Re10kSource:
    """RealEstate10K below a folder; a `PreparationSource`.

    Either chunks, `[train|test/]000000.torch` with index.json, or camera files
    `[train|test/]KEY.txt` with frames `[train|test/]KEY/TIMESTAMP.jpg` below `images`.
    """

    folder: Path
    """Of the chunks or camera files, or of train/ and test/ with them."""
    images: Path | None = None
    """Where the frames of camera files lie, if not in `folder`."""
    size: int = 256
    """Height and width of the prepared frames."""
    splits: tuple[Literal["train", "test"], ...] = _PARTS
    """Clips of other splits are left out."""

    def jobs(self) -> Sequence[SceneJob]:
        """All clips of the wanted splits.

        Raises:
            FileNotFoundError: There is no such folder, or no clip of these splits in it.
            ValueError: An index is damaged.
        """
        if self.size < 1:
            raise ValueError(f"size must be 1 or more, got {self.size}")
        if not self.folder.is_dir():
            raise FileNotFoundError(f"there is no folder {self.folder}")
        known: set[str] = set()
        jobs = [job for split in self.splits for job in self._jobs_of(split, known)]
        if not jobs:
            raise FileNotFoundError(
                f"{self.folder} holds no clips of RealEstate10K for {' or '.join(self.splits)}; "
                "wanted train/ and test/ with *.torch chunks, or with camera files *.txt"
            )
        return jobs

    def _jobs_of(self, split: Literal["train", "test"], known: set[str]) -> Iterator[SceneJob]:
        """The clips of a split. Its names are added to the known ones, those of other clips."""
        folder = self.folder if self.folder.name == split else self.folder / split
        index = _chunk_index(folder) if folder.is_dir() else []
        shares = Counter(name for _, name in index)
        for number, (key, name) in enumerate(index):
            path = folder / name
            size = path.stat().st_size if path.is_file() else 0
            num_frames = -(-size // (shares[name] * _FRAME_BYTES))
            clip = partial(_clip_of_chunk, path, key)
            if not can_name_a_scene(key) or key in known:
                place = f"{split}-{path.stem}-{number}"
                key, clip = place, partial(_without_name, path, key, place)
            known.add(key)
            yield self._job(key, split, num_frames, clip)
        for path in [] if index else sorted(folder.glob("*.txt")):
            images = self.images or self.folder
            clip = partial(_clip_of_text, path, (images / split / path.stem, images / path.stem))
            key = path.stem
            if key in known:
                place = f"{split}-{path.stem}"
                key, clip = place, partial(_without_name, path, key, place)
            known.add(key)
            yield self._job(key, split, _CLIP_FRAMES, clip)

    def _job(
        self,
        key: str,
        split: Literal["train", "test"],
        num_frames: int,
        clip: Callable[[], Re10kClip],
    ) -> SceneJob:
        info = SceneInfo(key, "re10k", split, "arbitrary", {"size": self.size})
        estimate = estimate_bytes(num_frames, self.size, self.size, ("images",))
        return SceneJob(info, estimate, partial(_frames_of, clip, self.size))


def read_chunk(path: Path) -> dict[str, Any]:
    """What a .torch chunk holds of each clip, not yet checked, by the clip's key.

    A clip without a key that can name a folder, or with that of one before it, is found by the
    names of the chunk's folder and the chunk, and its number. Only tensors and plain containers
    are loaded.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is cut off, is no chunk, or holds anything that could run code.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no chunk {path}")
    try:
        # Mapped: of a chunk of 100 MB only the clips that are asked for are read.
        mapped = zipfile.is_zipfile(path)
        rows = torch.load(path, map_location="cpu", weights_only=True, mmap=mapped)
    except pickle.UnpicklingError as error:
        raise ValueError(
            f"{path} is refused: it holds more than tensors, lists and dictionaries, or is cut "
            "off; fetch the chunk again from a source you trust"
        ) from error
    except (*UNREADABLE, MemoryError) as error:
        reason = reason_of(error).partition(". ")[0]
        raise ValueError(
            f"{path} is cut off or no .torch file ({reason}); fetch it again"
        ) from error
    if not isinstance(rows, list):
        raise ValueError(f"{path} holds a {type(rows).__name__}, wanted a list of clips")
    clips: dict[str, Any] = {}
    for number, row in enumerate(rows):
        key = row.get("key") if isinstance(row, dict) else None
        if not isinstance(key, str) or not can_name_a_scene(key) or key in clips:
            key = f"{path.parent.name}-{path.stem}-{number}"
        clips[key] = row
    return clips


def read_camera_file(path: Path) -> tuple[Float[np.ndarray, "frame 18"], tuple[int, ...]]:
    """The cameras and timestamps (microseconds) of a clip's text file.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is no camera file of RealEstate10K, or lists no frame.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        rows = [line.split() for line in lines[1:] if line.strip()]  # the first is the address
        times = tuple(int(row[0]) for row in rows)
        cameras = np.array([[float(value) for value in row[1:]] for row in rows])
    except ValueError as error:
        raise ValueError(f"{path} is no camera file of RealEstate10K ({error})") from error
    if cameras.ndim != 2 or cameras.shape[1] != 18:
        raise ValueError(
            f"{path} is no camera file of RealEstate10K: wanted a line of address, then lines of "
            "19 numbers"
        )
    return cameras, times


def _chunk_index(folder: Path) -> list[tuple[str, str]]:
    """Each clip and its chunk; read from the chunks themselves where there is no index."""
    path = folder / "index.json"
    chunks = sorted(folder.glob("*.torch"))
    if not path.is_file():
        return [(key, chunk.name) for chunk in chunks for key in _keys_of(chunk)]
    index = read_json(path, "fetch it again")
    if not isinstance(index, dict) or not all(isinstance(name, str) for name in index.values()):
        raise ValueError(f"{path} is no index: wanted the file name of a chunk for each clip")
    outside = [name for name in index.values() if not can_name_a_scene(name)]
    if outside:
        raise ValueError(
            f"{path} names {reprlib.repr(outside[0])}, which is no name in its folder; fetch it "
            "again"
        )
    unlisted = [chunk.name for chunk in chunks if chunk.name not in set(index.values())]
    if unlisted:
        warnings.warn(
            f"{len(unlisted)} chunks are left out because {path} does not list them, such as "
            f"{unlisted[0]}; delete the index to read all",
            stacklevel=4,
        )
    return list(index.items())


def _keys_of(chunk: Path) -> list[str]:
    """The clips of a chunk; of a damaged one its place, so that a job of that name tells why."""
    try:
        return list(read_chunk(chunk))
    except ValueError:
        return [f"{chunk.parent.name}-{chunk.name}"]


def _checked_clip(row: Any, path: Path, key: str) -> Re10kClip:
    """The clip of a chunk.

    Raises:
        ValueError: It lacks a field, or its numbers of cameras and images differ.
    """
    if not isinstance(row, dict) or not {"key", "cameras", "images"} <= row.keys():
        found = reprlib.repr(sorted(map(str, row))) if isinstance(row, dict) else type(row).__name__
        raise ValueError(f"{path}: the clip {key} has {found}, wanted key, cameras and images")
    if row["key"] != key:
        _without_name(path, row["key"], key)
    cameras, images = row["cameras"], row["images"]
    if not _is_stored(cameras) or cameras.shape[1:] != (18,) or cameras.is_complex():
        raise ValueError(f"{path}: the cameras of clip {key} are not rows of 18 numbers")
    if not isinstance(images, list) or len(images) != len(cameras):
        count = len(images) if isinstance(images, list) else "no"
        raise ValueError(f"{path}: clip {key} has {len(cameras)} cameras but {count} images")
    if not all(_is_stored(image) and image.dtype == torch.uint8 for image in images):
        raise ValueError(f"{path}: the images of clip {key} are not bytes (uint8)")
    return Re10kClip(key, path, cameras.detach().double().numpy(), _LazyBytes(images))


def _without_name(path: Path, key: Any, place: str) -> NoReturn:
    raise ValueError(
        f"{path}: the key of the clip {place} is {reprlib.repr(key)}, which cannot name a scene or "
        "is that of another clip"
    )


def _is_stored(value: Any) -> bool:
    """Whether it is a plain tensor that has all its values, not one that stands for many."""
    if not isinstance(value, torch.Tensor) or value.layout != torch.strided or value.is_quantized:
        return False
    size = value.numel() * value.element_size()
    return value.device.type == "cpu" and size <= value.untyped_storage().nbytes()


class _LazyBytes(Sequence[bytes]):
    """Bytes of mapped tensors, read when they are asked for."""

    def __init__(self, tensors: list[torch.Tensor]):
        self._tensors = tensors

    def __len__(self) -> int:
        return len(self._tensors)

    def __getitem__(self, number: Any) -> Any:
        return self._tensors[number].numpy().tobytes()


_cached_chunk = lru_cache(maxsize=1)(read_chunk)  # the clips of a chunk come one after the other


def _clip_of_chunk(path: Path, key: str) -> Re10kClip:
    clips = _cached_chunk(path)
    if key not in clips:
        raise KeyError(f"{path} lacks the clip {key} that the index says it has")
    return _checked_clip(clips[key], path, key)


def _clip_of_text(path: Path, places: Sequence[Path]) -> Re10kClip:
    cameras, times = read_camera_file(path)
    folder = next((place for place in places if place.is_dir()), None)
    if folder is None:
        raise FileNotFoundError(
            f"there is no folder {places[-1]} with the frames of the clip {path.stem}; say with "
            "--images where they lie"
        )
    by_time = {p.stem: p for p in folder.iterdir() if p.suffix.lower() in _IMAGE_ENDINGS}
    files = [by_time.get(str(time), folder / f"{time}.jpg") for time in times]
    return Re10kClip(path.stem, path, cameras, files)


def _frames_of(clip: Callable[[], Re10kClip], size: int) -> Frames:
    clip_ = clip()
    if not len(clip_.images):
        raise ValueError(f"{clip_.source}: the clip {clip_.key} has no frame")
    widest = _field_of_view_rad(clip_.cameras)
    if widest > MAX_FIELD_OF_VIEW_RAD:
        raise LeftOutError("a field of view over 100 degrees")
    pixel_map = fit_pixels(HEIGHT, WIDTH, size, size)
    for number, (camera, data) in enumerate(zip(clip_.cameras, clip_.images, strict=True)):
        place = f"{clip_.source}: the picture of frame {number} of clip {clip_.key}"
        yield _frame(number, camera, data, pixel_map, place)


def _frame(
    number: int,
    camera: Float[np.ndarray, "18"],
    data: bytes | Path,
    pixel_map: PixelMap,
    place: str,
) -> PreparedFrame | DroppedFrame:
    cam_from_world = np.eye(4)
    cam_from_world[:3] = camera[6:].reshape(3, 4)
    fault = pose_fault(cam_from_world)
    if fault is None and not _usable(camera[None, :4])[0]:
        fault = "intrinsics that are not shares of the picture's size"
    if fault is not None:
        return DroppedFrame(str(number), fault)
    if isinstance(data, Path) and not data.is_file():
        return DroppedFrame(str(number), "a missing picture")
    fx, fy, cx, cy = camera[:4] * (WIDTH, HEIGHT, WIDTH, HEIGHT)
    rows = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
    intrinsics = torch.tensor(rows, dtype=torch.float64)
    return PreparedFrame(
        source=str(number),
        image=crop_image(_decoded(data, place), pixel_map),
        world_from_cam=invert_rigid(torch.from_numpy(cam_from_world)).numpy(),
        intrinsics=pixel_map.intrinsics_to_model(intrinsics).numpy(),
    )


def _decoded(data: bytes | Path, place: str) -> Image.Image:
    with naming_damage(place):
        file = io.BytesIO(data) if isinstance(data, bytes) else data
        image = Image.open(file, formats=("JPEG", "PNG"))
    if image.size != (WIDTH, HEIGHT):
        raise LeftOutError(f"pictures that are not {WIDTH} x {HEIGHT}")
    with naming_damage(place):
        return image.convert("RGB")


def _usable(intrinsics: Float[np.ndarray, "frame 4"]) -> Bool[np.ndarray, " frame"]:
    """Whether fx, fy, cx, cy can be shares of a picture's size; in pixels cx is far above 1.

    Tiny focal lengths are left to the limit on the field of view, which leaves the clip out.
    """
    focal, center = intrinsics[:, :2], intrinsics[:, 2:]
    inside = ((focal > 0) & (focal <= FOCAL_RANGE[1])).all(axis=1)
    inside &= (center > 0).all(axis=1) & (center < 1).all(axis=1)
    return np.asarray(inside & np.isfinite(intrinsics).all(axis=1))


def _field_of_view_rad(cameras: Float[np.ndarray, "frame 18"]) -> float:
    """The widest field of view, horizontal or vertical, of the usable cameras of a clip."""
    usable = cameras[_usable(cameras[:, :4])]
    focal, center = usable[:, :2], usable[:, 2:4]
    angles = np.arctan(center / focal) + np.arctan((1 - center) / focal)
    return float(angles.max(initial=0.0))
