"""Versions of the scene folder, and how the header of an older one becomes one of today."""

import reprlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

VERSION = 4
"""Raised when a reader of the old version would misread the new one."""
FROM_GAUSSIANS = ("from", "gaussians")
"""near_far of an upgraded header: to be computed. A tuple, which no JSON file can hold."""


def _from_1(header: dict[str, Any]) -> dict[str, Any]:
    """Version 1 kept the photos below previews/ and drew by the distances of the day."""
    return header | {"inputs_folder": "previews/inputs", "near_far": FROM_GAUSSIANS}


def _from_2(header: dict[str, Any]) -> dict[str, Any]:
    """Version 2 knew no edits, no hidden objects and no scene without photos."""
    return header


def _from_3(header: dict[str, Any]) -> dict[str, Any]:
    """Version 3 kept a bare list in objects.json, without masks, and no up that was given."""
    return header


UPGRADES: dict[int, Callable[[dict[str, Any]], dict[str, Any]]] = {
    1: _from_1, 2: _from_2, 3: _from_3,
}  # fmt: skip
"""From each version to the next one."""
INPUTS_FOLDERS = ("inputs", "previews/inputs")
"""Where photos may lie in a scene folder; a header that names another place is damaged."""


def upgraded(header: Any, file: Path) -> dict[str, Any]:
    """The header of a scene.json of any version up to today's, as one of today.

    Args:
        header: What the file holds.
        file: For messages.

    Raises:
        ValueError: It is no header, or of a version that this program does not know.
    """
    version = header.get("version") if isinstance(header, dict) else None
    if type(version) is not int or not 1 <= version <= VERSION:
        raise ValueError(
            f"{file}: this program reads scenes of versions 1 to {VERSION}, not "
            f"{reprlib.repr(version)}; reconstruct the scene again or use a newer program"
        )
    for step in range(version, VERSION):
        header = UPGRADES[step](header)
    if header.get("inputs_folder") not in INPUTS_FOLDERS:
        raise ValueError(
            f"{file}: inputs_folder is {reprlib.repr(header.get('inputs_folder'))}, not 'inputs'"
        )
    return header
