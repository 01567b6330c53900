"""What a prepared scene consists of, and the scene.json that says so."""

import os
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float, UInt8, UInt16

from instok3d.datasets.poses import ROTATION_TOLERANCE
from instok3d.geometry.camera_json import read_intrinsics, read_pose
from instok3d.reading import naming_damage, one_of, read_json, text, whole_number

FORMAT = "instok3d-scene-1"
RECORD = "scene.json"
LAYERS = ("images", "depths", "instances", "labels")
"""Folders of pictures in a scene; each but the first may be missing."""
MAX_PIXELS = 2**26
"""Sizes beyond are taken for damage before anything is allocated."""

Dataset = Literal["scannet", "re10k", "mipnerf360", "colmap", "footage"]
Split = Literal["train", "val", "test"]
Unit = Literal["metre", "arbitrary"]
"""Of cameras and depths; depths are stored in thousandths of it."""


MAX_NAME_BYTES = 200
"""Of a scene; file systems take 255."""


def can_name_a_scene(name: str) -> bool:
    """Whether a scene and its folder may have this name."""
    if not name or name.startswith(".") or len(name.encode(errors="replace")) > MAX_NAME_BYTES:
        return False
    try:
        os.fsencode(name)
    except UnicodeEncodeError:  # half a character
        return False
    return all(character not in "/\\" and ord(character) >= 32 for character in name)


@dataclass(frozen=True)
class SceneInfo:
    """What a scene is, before its frames are known."""

    name: str
    """Also the name of its folder."""
    dataset: Dataset
    split: Split
    unit: Unit
    settings: dict[str, Any] = field(default_factory=dict)
    """How it was prepared; scenes of one folder made with other settings are not mixed."""

    def __post_init__(self):
        if not can_name_a_scene(self.name):
            raise ValueError(f"{self.name!r} cannot be the name of a scene and its folder")
        for value, words in ((self.dataset, Dataset), (self.split, Split), (self.unit, Unit)):
            if value not in get_args(words):
                raise ValueError(f"scene {self.name}: {value!r} is none of {get_args(words)}")


@dataclass(frozen=True)
class PreparedFrame:
    """One frame at the size and in the conventions of the prepared folder."""

    source: str
    """Its name or number in the original data."""
    image: UInt8[np.ndarray, "height width 3"]
    """sRGB bytes."""
    world_from_cam: Float[np.ndarray, "4 4"] | None
    """None in scenes without cameras, which serve for masks but not for training."""
    intrinsics: Float[np.ndarray, "3 3"] | None
    """Pixels of this image; the centre of the top-left pixel is (0.5, 0.5). None without pose."""
    depth_thousandths: UInt16[np.ndarray, "height width"] | None = None
    """z-depth in thousandths of the unit (millimetres), 0 = unknown."""
    instances: UInt16[np.ndarray, "height width"] | None = None
    """Ids that hold over the whole scene, 0 = none."""
    labels: UInt16[np.ndarray, "height width"] | None = None
    """Raw class ids of the data set, 0 = unlabelled."""


@dataclass(frozen=True)
class DroppedFrame:
    """A frame of the original data that was left out."""

    source: str
    reason: str
    """A few words; frames are counted by them."""


@dataclass(frozen=True)
class SceneRecord:
    """A scene.json as it was read."""

    info: SceneInfo
    height: int
    width: int
    sources: tuple[str, ...]
    world_from_cam: Float[np.ndarray, "frame 4 4"] | None
    """None in scenes without cameras."""
    intrinsics: Float[np.ndarray, "frame 3 3"] | None
    dropped: dict[str, int]
    """How many frames of the original were left out, by reason."""
    files: dict[str, tuple[int, str]]
    """Bytes and SHA-256 of each file, by its path below the scene."""

    @property
    def num_bytes(self) -> int:
        """Of all files that the record lists."""
        return sum(size for size, _ in self.files.values())


def read_scene(folder: Path) -> SceneRecord:
    """The record of one scene folder.

    Raises:
        FileNotFoundError: It has no scene.json.
        ValueError: The scene.json is damaged, of another format, or of cameras that cannot be.
    """
    path = folder / RECORD
    remedy = f"delete the folder {folder} and prepare it again"
    record = read_record(path, FORMAT, remedy)
    with naming_damage(path, remedy):
        height, width = whole_number(record["height"], 1), whole_number(record["width"], 1)
        if height * width > MAX_PIXELS:
            raise ValueError(f"pictures of {height} x {width} are too large")
        poses, intrinsics = _cameras(record["frames"], height, width)
        files = {
            name: (whole_number(size), text(sha)) for name, (size, sha) in record["files"].items()
        }
        _check_files(files, len(record["frames"]))
        return SceneRecord(
            info=SceneInfo(
                text(record["name"]),
                one_of(record["dataset"], get_args(Dataset)),
                one_of(record["split"], get_args(Split)),
                one_of(record["unit"], get_args(Unit)),
                dict(record["settings"]),
            ),
            height=height,
            width=width,
            sources=tuple(text(frame["source"]) for frame in record["frames"]),
            world_from_cam=poses,
            intrinsics=intrinsics,
            dropped={reason: whole_number(count) for reason, count in record["dropped"].items()},
            files=files,
        )


def read_record(path: Path, wanted: str, remedy: str) -> dict[str, Any]:
    """A JSON object that says it has the wanted format.

    Args:
        path: The file.
        wanted: The format.
        remedy: What to do about a damaged one.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged or of another format.
    """
    value = read_json(path, remedy)
    found = value.get("format") if isinstance(value, dict) else None
    if found != wanted:
        raise ValueError(
            f"{path} is damaged (its format is {reprlib.repr(found)}, not {wanted}); {remedy}"
        )
    return value


def check_camera(pose: Any, intrinsics: Any, *, where: str, height: int, width: int) -> None:
    """Refuse a camera that no prepared scene may have.

    Args:
        pose: World_from_cam as lists of numbers.
        intrinsics: Likewise.
        where: File and frame, the subject of the message.
        height: Of the frame, pixels.
        width: Likewise.

    Raises:
        ValueError: It cannot be a camera.
    """
    read_pose(pose, where=where, tolerance=ROTATION_TOLERANCE)
    read_intrinsics(intrinsics, where=where, height=height, width=width)


def _cameras(
    frames: list[dict[str, Any]], height: int, width: int
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """The matrices of all frames, checked; None where no frame has them."""
    pairs = [(frame["world_from_cam"], frame["intrinsics"]) for frame in frames]
    if pairs and all(pair == (None, None) for pair in pairs):
        return None, None
    for number, pair in enumerate(pairs):
        check_camera(*pair, where=f"frame {number}", height=height, width=width)
    poses = np.array([pose for pose, _ in pairs], np.float64).reshape(-1, 4, 4)
    return poses, np.array([matrix for _, matrix in pairs], np.float64).reshape(-1, 3, 3)


def _check_files(files: Mapping[str, object], num_frames: int) -> None:
    """Fail unless every frame has one file in each folder of the scene."""
    layers = {name.partition("/")[0] for name in files}
    wanted = {f"{layer}/{k:06d}.png" for layer in layers | {"images"} for k in range(num_frames)}
    if not layers <= set(LAYERS) or files.keys() != wanted:
        raise ValueError(f"its files are not one for each of its {num_frames} frames")
