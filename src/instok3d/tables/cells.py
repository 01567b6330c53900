"""Cells: what was measured of one method on one set of scenes, and how; a file each."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path
from typing import Any

from instok3d.files import write_json
from instok3d.reading import naming_damage, read_json
from instok3d.tables.code_version import code_hash
from instok3d.tables.data_sets import digest
from instok3d.tables.definitions import OnePass, PerScene, Row, Table, Tokenizer, Views
from instok3d.tables.trained import trained_model
from instok3d.tables.trainings import OURS, SEGMENTER, SEMANTICS
from instok3d.tables.work import Work, key_of


@dataclass(frozen=True)
class Cell:
    """Figures of one method on one set of scenes, with where they come from."""

    figures: Mapping[str, float | None]
    """By the names of the columns; None is what has no truth or no meaning here."""
    method: str
    """In words."""
    scenes: int
    scenes_sha256: str
    """Of the list of scenes (`scene_sets.digest`)."""
    weights_sha256: Sequence[str]
    """Of the models that it takes (`Asked.trainings`)."""
    command: str
    """That measured it."""
    commit: str
    machine: str
    seed: int | None
    hours: float
    """Of measuring."""
    training_hours: float | None
    """Of all these models; None where nobody knows."""


@dataclass(frozen=True)
class Asked:
    """A cell that a row needs: its pictures and masks, or its features."""

    row: Row
    views: Views
    of: str
    """'views' or 'features'."""

    @property
    def method(self) -> Tokenizer | PerScene | OnePass | None:
        """What is measured; None for all features that are lifted into the scenes of OURS."""
        method = self.row.method
        return method if self.of == "views" or isinstance(method, OnePass) else None

    @property
    def trainings(self) -> tuple[str, ...]:
        """Whose models it needs, that of the method first."""
        method = self.method
        if method is None:
            return (OURS, SEMANTICS)
        if isinstance(method, Tokenizer | OnePass):
            return (method.training,)
        geometry = (OURS,) if method.tracker == "predicted-depth" else ()
        return (*geometry, SEGMENTER) if method.masks == "segmenter" else geometry


def asked_of(table: Table) -> list[tuple[Row, list[Asked]]]:
    """The cells of each row, in the order of the table."""
    found = []
    for row in table.rows:
        parts = [("views", row.method), ("features", row.features)]
        found.append((row, [Asked(row, table.views, of) for of, what in parts if what is not None]))
    return found


def cell_path(work: Work, asked: Asked) -> Path:
    """Where a cell lies; the models that it needs must be there.

    All kinds of features of a set of scenes are one cell, which Tables 1 and 4 share.
    """
    scenes = work.scenes(asked.row.scenes, asked.views)
    weights = [trained_model(work, name).sha256 for name in asked.trainings]
    method = "features" if asked.method is None else asdict_of(asked.method)
    steps = work.method_steps if isinstance(asked.method, PerScene) else None
    key = key_of(
        method=method, weights=weights, scenes=digest(scenes.names), steps=steps,
        views=asked.views, quick=work.schedule.quick, code=code_hash("measuring"),
        lpips=None if work.lpips is None else work.lpips.trunk,
    )  # fmt: skip
    return work.folder / "cells" / f"{asked.of}-{key}.json"


def asdict_of(method: Any) -> dict[str, Any]:
    """A method as JSON, without the name of its training: its weights say which model it is."""
    return {"type": type(method).__name__, **asdict(method)} | (
        {"training": None} if isinstance(method, Tokenizer | OnePass) else {}
    )


REMEDY = "remove it, it is then measured again"


def write_cell(path: Path, cell: Cell) -> None:
    """Write a cell as a whole.

    Raises:
        ValueError: A figure is not finite.
    """
    wrong = [name for name, value in cell.figures.items() if value and not isfinite(value)]
    if wrong:
        raise ValueError(f"{wrong[0]} of {cell.method} is {cell.figures[wrong[0]]}: not a figure")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, asdict(cell))


def read_cell(path: Path) -> Cell:
    """A cell that is there.

    Raises:
        FileNotFoundError: It was not measured yet.
        ValueError: It is damaged.
    """
    with naming_damage(path, REMEDY):
        return Cell(**read_json(path, REMEDY))


def semantics_file(work: Work) -> Path:
    """The semantics of OURS: given, those that come with the default model, or trained here."""
    return trained_model(work, SEMANTICS).path
