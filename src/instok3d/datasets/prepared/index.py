"""The index of a prepared folder; it only repeats what the scenes say."""

import reprlib
from pathlib import Path
from typing import Any, get_args

from instok3d.datasets.prepared.format import (
    RECORD,
    Dataset,
    Split,
    can_name_a_scene,
    read_record,
    read_scene,
)
from instok3d.files import sha256_of, write_json
from instok3d.reading import naming_damage, one_of, text, whole_number

INDEX_FORMAT = "instok3d-scenes-1"
INDEX = "scenes.json"


def scene_folders(folder: Path) -> list[Path]:
    """The scenes that lie in a prepared folder, by name; unfinished ones are hidden."""
    return sorted(path.parent for path in folder.glob(f"[!.]*/{RECORD}"))


def refresh_index(folder: Path) -> dict[str, Any]:
    """Write and return the index of what lies in a prepared folder; known scenes stay as they are.

    Raises:
        ValueError: A scene's record is damaged.
    """
    try:
        known = read_record(folder / INDEX, INDEX_FORMAT, "")["scenes"]
    except (FileNotFoundError, ValueError, KeyError):
        known = {}  # everything in it is derived from the folders
    scenes, datasets = {}, set()
    for scene in scene_folders(folder):
        sha256 = sha256_of(scene / RECORD)
        entry = known.get(scene.name)
        if not (isinstance(entry, dict) and entry.get("sha256") == sha256 and "dataset" in entry):
            record = read_scene(scene)
            entry = {
                "dataset": record.info.dataset,
                "split": record.info.split,
                "split_rule": record.info.settings.get("split_rule", ""),
                "num_frames": len(record.sources),
                "cameras": record.world_from_cam is not None,
                "bytes": record.num_bytes,
                "sha256": sha256,
            }
        datasets.add(entry["dataset"])
        scenes[scene.name] = entry
    index = {"format": INDEX_FORMAT, "dataset": "+".join(sorted(datasets)), "scenes": scenes}
    write_json(folder / INDEX, index)
    return index


def read_index(folder: Path) -> dict[str, dict[str, Any]]:
    """What the index says of each scene.

    The keys are dataset, split, split_rule, num_frames, cameras, bytes and sha256.

    Raises:
        FileNotFoundError: The folder is not there or has no index.
        ValueError: The index is damaged or of another format.
    """
    if not (folder / INDEX).is_file():
        raise FileNotFoundError(
            f"there is no {INDEX} in {folder}; make it with `instok3d data prepare`, or with "
            "`instok3d data verify --index` where scenes lie there already"
        )
    remedy = f"run `instok3d data verify --index {folder}`"
    index = read_record(folder / INDEX, INDEX_FORMAT, remedy)
    with naming_damage(folder / INDEX, remedy):
        for name, entry in index["scenes"].items():
            _check_entry(name, entry)
    return index["scenes"]


def _check_entry(name: str, entry: dict[str, Any]) -> None:
    if not can_name_a_scene(name):
        raise ValueError(f"{reprlib.repr(name)} is no name of a scene")
    one_of(entry["dataset"], get_args(Dataset))
    one_of(entry["split"], get_args(Split))
    whole_number(entry["num_frames"])
    text(entry["sha256"])
    if not isinstance(entry.get("cameras", True), bool):
        raise ValueError(f"{name} does not say whether it has cameras")
