"""Rows of a benchmark: those that it printed before, or new ones."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TypeVar

Row = TypeVar("Row")
"""A dataclass of JSON values."""


def known_or_measured(known: Sequence[Path], kind: type[Row], measured: Iterable[Row]) -> list[Row]:
    """The rows of files of JSON lines; without files those that are measured now.

    A new row is printed as a JSON object as soon as it is there.

    Args:
        known: What was printed before.
        kind: Of a row.
        measured: Measures a row at each step; not touched where some are known.
    """
    lines = [line for file in known for line in file.read_text().splitlines()]
    rows = [kind(**json.loads(line)) for line in lines]
    if not rows:
        for row in measured:
            print(json.dumps(asdict(row)), flush=True)  # pyright: ignore[reportArgumentType]
            rows.append(row)
    return rows
