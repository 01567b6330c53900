"""The masks.json beside id maps that a model made (`instok3d data masks`)."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        if record["format"] != MASKS_FORMAT:
            raise ValueError(f"the format is {record['format']}, not {MASKS_FORMAT}")
        others = ("format", "instok3d", "statistics", "files")
        return MasksRecord(
            settings={key: value for key, value in record.items() if key not in others},
            statistics=dict(record["statistics"]),
            files={str(name): (int(n), str(sha)) for name, (n, sha) in record["files"].items()},
        )
    except FileNotFoundError as error:
        raise FileNotFoundError(f"there is no {MASKS_RECORD} in {folder}") from error
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(
            f"{path} is damaged ({error!r}); make the masks again with `instok3d data masks "
            "--overwrite`"
        ) from error
