"""A table with its figures, as Markdown, LaTeX and JSON."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from instok3d.evaluation.differences import Difference
from instok3d.tables.cells import Asked, Cell
from instok3d.tables.definitions import FEATURE_KEYS, Column, Row, Table
from instok3d.tables.features import figure_name
from instok3d.version import short

NOTHING = "--"
"""Stands where a method has no such figure by its nature, as in the paper."""

_ESCAPES = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"} | {
    sign: f"\\{sign}" for sign in "&%$#_{}"
}


@dataclass(frozen=True)
class FilledRow:
    """A row with the cells behind it."""

    row: Row
    cells: Mapping[str, Cell]
    """By 'views' and 'features'."""
    files: Mapping[str, str]
    """Where they lie, relative to the folder of the tables."""
    differences: Mapping[str, Difference] = field(default_factory=dict)
    """By the names of columns: this row minus the reference on the same scenes."""

    def figure(self, table: Table, column: Column) -> float | None:
        """The figure of a column; None where the row has none by its nature.

        Raises:
            ValueError: It should have one.
        """
        of = "features" if column.key in FEATURE_KEYS else "views"
        if of not in self.cells or column.key in self.row.without:
            return None
        key = column.key
        if of == "features":
            assert self.row.features is not None
            key = figure_name(self.row.features, key)
        value = self.cells[of].figures.get(key)
        if value is None:
            raise ValueError(
                f"Table {table.number}, row {self.row.label!r} has no {column.title}: "
                f"{self.files[of]} was measured without it; no blank stands for a prediction"
            )
        return value


@dataclass(frozen=True)
class FilledTable:
    """A table with figures."""

    table: Table
    rows: tuple[FilledRow, ...]
    notes: tuple[str, ...] = ()

    def figures(self) -> list[list[float | None]]:
        """By rows and columns.

        Raises:
            ValueError: One is missing.
        """
        return [[row.figure(self.table, each) for each in self.table.columns] for row in self.rows]

    def best(self) -> set[tuple[int, int]]:
        """Row and column of the best figures among rows on the same scenes.

        Upper bounds do not count, and nothing is best of one.
        """
        values, found = self.figures(), set()
        for kind in {row.row.scenes for row in self.rows}:
            rivals = [
                number
                for number, row in enumerate(self.rows)
                if row.row.scenes == kind and row.row.compared and not row.row.upper_bound
            ]
            for place, column in enumerate(self.table.columns):
                known = [(v, n) for n in rivals if (v := values[n][place]) is not None]
                if column.better and len(known) > 1:
                    best = (max if column.better == "up" else min)(value for value, _ in known)
                    text = _text(best, column)
                    found |= {(n, place) for value, n in known if _text(value, column) == text}
        return found


def as_markdown(filled: FilledTable) -> str:
    """The table, how far each row is from the reference, and where each row comes from."""
    table, best = filled.table, filled.best()
    head = [*_kinds(table, "type"), "method", *(column.title for column in table.columns)]
    lines = [f"### Table {table.number}: {table.title}", "", _bar(head), "|---" * len(head) + "|"]
    for place, (row, values) in enumerate(zip(filled.rows, filled.figures(), strict=True)):
        cells = [_cell(v, c) for v, c in zip(values, table.columns, strict=True)]
        cells = [f"**{x}**" if (place, n) in best else x for n, x in enumerate(cells)]
        label = f"{row.row.label} (upper bound)" if row.row.upper_bound else row.row.label
        lines.append(_bar([*_kinds(table, row.row.kind), label, *cells]))
    lines += ["", *_differences(filled)]
    lines += [f"- {note}" for note in [*filled.notes, *_origins(filled)]]
    return "\n".join(lines) + "\n"


def as_latex(filled: FilledTable) -> str:
    """The same for a paper, with the rules of the package booktabs."""
    table, best = filled.table, filled.best()
    arrows = {"up": r"$\uparrow$", "down": r"$\downarrow$", "": ""}
    head = [*_kinds(table, "Type"), "Method"]
    head = [escaped(text) for text in head]
    head += [escaped(column.title) + arrows[column.better] for column in table.columns]
    shape = "l" * (len(head) - len(table.columns)) + "c" * len(table.columns)
    lines = [rf"\begin{{tabular}}{{{shape}}}", r"\toprule", " & ".join(head) + r" \\", r"\midrule"]
    for place, (row, values) in enumerate(zip(filled.rows, filled.figures(), strict=True)):
        cells = [_cell(v, c) for v, c in zip(values, table.columns, strict=True)]
        cells = [rf"\textbf{{{x}}}" if (place, n) in best else x for n, x in enumerate(cells)]
        label = row.row.label + (" (upper bound)" if row.row.upper_bound else "")
        words = [escaped(text) for text in [*_kinds(table, row.row.kind), label]]
        lines.append(" & ".join([*words, *cells]) + r" \\")
    lines += [r"\bottomrule", r"\end{tabular}"]
    notes = [f"% {' '.join(note.split())}" for note in [*filled.notes, *_origins(filled)]]
    return "\n".join([f"% Table {table.number}: {table.title}", *notes, *lines]) + "\n"


def as_json(filled: FilledTable) -> dict[str, Any]:
    """Everything, with the whole cells."""
    keys = [column.key for column in filled.table.columns]
    return {
        "table": filled.table.number,
        "title": filled.table.title,
        "columns": keys,
        "notes": list(filled.notes),
        "rows": [
            {
                "label": row.row.label,
                "kind": row.row.kind,
                "upper_bound": row.row.upper_bound,
                "figures": dict(zip(keys, values, strict=True)),
                "cells": {name: asdict(cell) for name, cell in row.cells.items()},
                "files": dict(row.files),
                "minus_reference": {k: asdict(d) for k, d in row.differences.items()},
            }
            for row, values in zip(filled.rows, filled.figures(), strict=True)
        ],
    }


def escaped(text: str) -> str:
    """Text as LaTeX shows it letter by letter."""
    return "".join(_ESCAPES.get(sign, sign) for sign in text)


def filled_row(
    row: Row,
    measured: Sequence[tuple[Asked, Cell, str]],
    differences: Mapping[str, Difference],
) -> FilledRow:
    """A row with what was measured of it: each with its cell and the cell's file."""
    return FilledRow(
        row,
        {asked.of: cell for asked, cell, _ in measured},
        {asked.of: file for asked, _, file in measured},
        differences,
    )


def _kinds(table: Table, text: str) -> list[str]:
    return [text] if any(row.kind for row in table.rows) else []


def _bar(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(value: float | None, column: Column) -> str:
    return NOTHING if value is None else _text(value, column)


def _text(value: float, column: Column) -> str:
    return f"{value:,.{column.decimals}f}"


def _differences(filled: FilledTable) -> list[str]:
    """A table of the rows that are compared with a reference; no line where none is."""
    rows = [row for row in filled.rows if row.differences]
    known = {key for row in rows for key in row.differences}
    columns = [each for each in filled.table.columns if each.key in known]
    if not rows:
        return []
    lines = [
        "Minus the reference, ± the standard error over the choice of scenes:",
        "",
        _bar(["method", *(column.title for column in columns)]),
        "|---" * (1 + len(columns)) + "|",
    ]
    for row in rows:
        texts = [_difference(row.differences.get(column.key), column) for column in columns]
        lines.append(_bar([row.row.label, *texts]))
    return [*lines, ""]


def _difference(found: Difference | None, column: Column) -> str:
    if found is None:
        return NOTHING
    return f"{found.value:+.{column.decimals}f} ± {found.standard_error:.{column.decimals}f}"


def _origins(filled: FilledTable) -> list[str]:
    """One line for each row: scenes, hashes, seed, hours, commit, command."""
    lines = []
    for row in filled.rows:
        for name, cell in row.cells.items():
            weights = " + ".join(sha[:12] for sha in cell.weights_sha256)
            weights = f", weights {weights}" if weights else ""
            hours = f"{cell.hours:.2f} h"
            if cell.training_hours is not None:
                hours += f" + {cell.training_hours:.2f} h training"
            lines.append(
                f"{row.row.label}, {name}: {cell.scenes} scenes, list {cell.scenes_sha256[:12]}"
                f"{weights}, seed {'-' if cell.seed is None else cell.seed}, {hours}, "
                f"{short(cell.commit)}, {cell.machine}, `{cell.command}`"
            )
    return lines
