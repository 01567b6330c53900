"""The masks.json beside id maps that a model made (`instok3d data masks`)."""

import reprlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from instok3d.datasets.prepared.format import can_name_a_scene, read_record
from instok3d.reading import naming_damage, text, whole_number

MASKS_FORMAT = "instok3d-masks-1"
MASKS_RECORD = "masks.json"
MADE_BY = ("model", "weights_sha256", "automatic", "config")
"""What the ids of one training run must have in common."""


@dataclass(frozen=True)
class MasksRecord:
    """A masks.json as it was read."""

    settings: dict[str, Any]
    """Model, weights and everything else that the masks depend on."""
    statistics: dict[str, Any]
    files: dict[str, tuple[int, str]]
    """Bytes and SHA-256 of each id map, by its name in the folder."""


def read_masks_record(folder: Path) -> MasksRecord:
    """The record of a folder of id maps.

    Raises:
        FileNotFoundError: The folder has none.
        ValueError: It is damaged or of another format.
    """
    path = folder / MASKS_RECORD
    if not path.is_file():
        raise FileNotFoundError(f"there is no {MASKS_RECORD} in {folder}")
    remedy = "make the masks again with `instok3d data masks --overwrite`"
    record = read_record(path, MASKS_FORMAT, remedy)
    with naming_damage(path, remedy):
        others = ("format", "instok3d", "statistics", "files")
        files = {n: (whole_number(size), text(sha)) for n, (size, sha) in record["files"].items()}
        if outside := [name for name in files if not can_name_a_scene(name)]:
            raise ValueError(f"{reprlib.repr(outside[0])} is no name of a file in its folder")
        return MasksRecord(
            settings={key: value for key, value in record.items() if key not in others},
            statistics=dict(record["statistics"]),
            files=files,
        )
