"""What a prepared scene consists of, and the scene.json that says so."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float, UInt8, UInt16

FORMAT = "instok3d-scene-1"
RECORD = "scene.json"

Dataset = Literal["scannet", "re10k", "mipnerf360", "colmap", "footage"]
Split = Literal["train", "val", "test"]
Unit = Literal["metre", "arbitrary"]
"""Of cameras and depths; depths are stored in thousandths of it."""


def can_name_a_scene(name: str) -> bool:
    """Whether a scene and its folder may have this name."""
    return bool(name) and not name.startswith(".") and not {"/", "\\", "\0"} & set(name)


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
        ValueError: The scene.json is damaged or of another format.
    """
    path = folder / RECORD
    remedy = f"delete the folder {folder} and prepare it again"
    record = read_json(path, FORMAT, remedy)
    try:
        info = SceneInfo(
            **{key: record[key] for key in ("name", "dataset", "split", "unit", "settings")}
        )
        frames = record["frames"]
        return SceneRecord(
            info=info,
            height=int(record["height"]),
            width=int(record["width"]),
            sources=tuple(str(frame["source"]) for frame in frames),
            world_from_cam=_matrices([frame["world_from_cam"] for frame in frames], 4),
            intrinsics=_matrices([frame["intrinsics"] for frame in frames], 3),
            dropped={str(reason): int(count) for reason, count in record["dropped"].items()},
            files={
                str(name): (int(size), str(sha)) for name, (size, sha) in record["files"].items()
            },
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(f"{path} is damaged ({error}); {remedy}") from error


def read_json(path: Path, wanted: str, remedy: str) -> dict[str, Any]:
    """A JSON object that says it has the wanted format.

    Args:
        path: The file.
        wanted: The format.
        remedy: What to do about a damaged one.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged or of another format.
    """
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise FileNotFoundError(f"there is no file {path}") from error
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is damaged ({error}); {remedy}") from error
    if not isinstance(value, dict) or value.get("format") != wanted:
        raise ValueError(f"{path} is not of the format {wanted}; {remedy}")
    return value


def _matrices(rows: list[Any], size: int) -> np.ndarray | None:
    if rows and all(row is None for row in rows):
        return None
    matrices = np.array(rows, dtype=np.float64).reshape(len(rows), size, size)
    if not np.isfinite(matrices).all():
        raise ValueError("a camera is not finite")
    return matrices
