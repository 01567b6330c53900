"""Whose work a run's pictures show: from the data to the run, from the run to the model's card."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import safe_open

from instok3d.data.scenes import SceneSource
from instok3d.files import write_json
from instok3d.reading import naming_damage, one_line, parse_json, read_json

CREDITS = "credits.json"
REMEDY = "restore it, or start the run anew in another folder"


def keep_credits(
    folder: Path, source: SceneSource, *, resume: bool, init_from: Path | None
) -> None:
    """Write RUN/credits.json: the lines of its scenes, of its first weights, of its past.

    Args:
        folder: The run.
        source: Its scenes; those of `instok3d data rooms` with catalogues have `credits`.
        resume: Whether what the folder says already is of this run.
        init_from: Run folder or .safetensors file that gave the first weights.
    """
    lines = set(getattr(source, "credits", ()))
    lines |= set(read_credits(folder)) if resume else set()
    lines |= set(_of_weights(init_from)) if init_from else set()
    if lines:
        write_json(folder / CREDITS, sorted(lines))
    elif not resume:
        (folder / CREDITS).unlink(missing_ok=True)


def read_credits(folder: Path) -> list[str]:
    """The lines of a run; none where it owes nobody.

    Raises:
        ValueError: The file is damaged.
    """
    path = folder / CREDITS
    if not path.exists():
        return []
    with naming_damage(path, REMEDY):
        return _lines(read_json(path, REMEDY))


def _of_weights(path: Path) -> list[str]:
    """The lines of a run folder, or of the card in a file of weights."""
    if path.is_dir():
        return read_credits(path)
    with naming_damage(path, "get it again"), safe_open(path, framework="pt") as file:
        metadata: Mapping[str, str] = file.metadata() or {}
        card: Any = parse_json(metadata.get("card", "{}"), f"{path}, its card", "get it again")
        return _lines(card.get("credits", []))


def _lines(value: Any) -> list[str]:
    if not isinstance(value, list):
        raise ValueError("its credits are no list of lines")
    return [one_line(line) for line in value]
