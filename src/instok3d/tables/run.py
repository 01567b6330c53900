"""The tables from their plan: train, measure, write."""

import time
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

from instok3d.evaluation.differences import Difference, differences
from instok3d.evaluation.scores import SceneScore
from instok3d.files import replacing, write_json
from instok3d.locking import alone_in, remove_leftovers
from instok3d.model.files import load_model
from instok3d.progress import StatusLine, format_duration
from instok3d.tables.cells import asked_of, cell_path
from instok3d.tables.definitions import FEATURE_KEYS, SceneKind, Table
from instok3d.tables.filled import FilledTable, as_json, as_latex, as_markdown, filled_row
from instok3d.tables.manipulation import Picture, edited_scenes
from instok3d.tables.measuring import MASKS, measure, read_scores
from instok3d.tables.plan import TablesPlan, make_plan
from instok3d.tables.qualitative import write_edits, write_figures
from instok3d.tables.trained import train_model, trained_model
from instok3d.tables.trainings import OURS
from instok3d.tables.work import PICTURED, Work

LOCK = ".lock"
EDITED = 2
"""The table whose scenes the figure of edits shows."""


def make_tables(work: Work, tables: Sequence[Table], *, resume: bool = False) -> list[Path]:
    """Train what is missing, measure what is missing, write the tables; returns their files.

    Args:
        work: The folder and what the tables are made of.
        tables: Which.
        resume: Go on in a folder that holds tables.

    Raises:
        ValueError: The folder holds tables and resume is off, another process is at work in it, or
            a figure is missing.
        FileNotFoundError: Rooms, captures or given models are not there.
    """
    folder = work.folder
    if folder.exists() and any(folder.iterdir()) and not resume:
        raise ValueError(f"{folder} is not empty: pass --resume to go on, or choose another folder")
    plan = make_plan(work, tables)
    if plan.missing:
        raise FileNotFoundError("; ".join(plan.missing))
    folder.mkdir(parents=True, exist_ok=True)
    with alone_in(folder / LOCK, f"another process makes tables in {folder}; wait for its end"):
        for place in (folder, folder / "cells", *(folder / "cells").glob("*/"),
                      *(folder / MASKS).glob("*/")):  # fmt: skip
            remove_leftovers(place)
        _do(work, plan)
        return [path for table in tables for path in write_table(work, table)]


def _do(work: Work, plan: TablesPlan) -> None:
    """Every step that is left, with a line for each."""
    status, left = StatusLine(), plan.hours
    for number, step in enumerate(plan.steps, start=1):
        if step.done:
            continue
        title = f"{number}/{len(plan.steps)} {step.what}"
        status.print_above(f"{title}  (about {format_duration(3600 * left)} left in all)")
        started = time.monotonic()
        if step.training is not None:
            train_model(work, step.training)
        elif step.asked is not None:
            measure(work, step.asked, title)
        left = max(0.0, left - step.hours)
        status.print_above(f"{title}  took {format_duration(time.monotonic() - started)}")


def write_table(work: Work, table: Table) -> list[Path]:
    """Markdown, LaTeX, JSON and figures of a table whose cells are all there.

    Raises:
        FileNotFoundError: A cell is not.
        ValueError: A figure is missing.
    """
    measured_rows, folders = [], []
    for row, asked in asked_of(table):
        paths = {each.of: cell_path(work, each) for each in asked}
        measured = [
            (each, measure(work, each, row.label), str(paths[each.of].relative_to(work.folder)))
            for each in asked
        ]
        measured_rows.append((row, measured))
        folders.append((row, {of: path.with_suffix("") for of, path in paths.items()}))
    found = _differences(work, table, {row.label: files for row, files in folders})
    rows = [filled_row(row, cells, found.get(row.label, {})) for row, cells in measured_rows]
    filled = FilledTable(table, tuple(rows), _notes(work))
    texts = {"md": as_markdown(filled), "tex": as_latex(filled)}
    value = as_json(filled)
    figures = write_figures(work.folder, table.number, folders, len(_test_names(work, table)))
    if table.number == EDITED:
        figures += write_edits(work.folder, _edits(work, table))
    stem = work.folder / f"table{table.number}"
    for suffix, text in texts.items():
        with replacing(stem.with_suffix(f".{suffix}")) as part:
            part.write_text(text)
    write_json(stem.with_suffix(".json"), value)
    return [stem.with_suffix(each) for each in (".md", ".tex", ".json")] + figures


def _differences(
    work: Work, table: Table, folders: Mapping[str, Mapping[str, Path]]
) -> dict[str, Mapping[str, Difference]]:
    """Of each row from the reference on the same scenes, by the label of the row.

    Args:
        work: Where the cells lie.
        table: All of it was measured.
        folders: Of the cells of each row, by its label and 'views' or 'features'.
    """
    with_views = [row for row in table.rows if "views" in folders[row.label]]
    references = {row.scenes: row for row in with_views if row.reference}
    keys = [each.key for each in table.columns if each.better and each.key not in FEATURE_KEYS]

    @cache
    def scores(label: str, kind: SceneKind) -> list[SceneScore]:
        count = len(work.scenes(kind, table.views).names)
        return read_scores(folders[label]["views"], count)

    return {
        row.label: differences(
            scores(row.label, row.scenes),
            scores(reference.label, row.scenes),
            [key for key in keys if key not in row.without | reference.without],
        )
        for row in with_views
        if (reference := references.get(row.scenes)) not in (None, row)
    }


def _edits(work: Work, table: Table) -> list[list[Picture]]:
    """Of the scenes that the other figures show, by OURS."""
    model = load_model(trained_model(work, OURS).path)
    count = min(PICTURED, len(_test_names(work, table)))
    scenes = [work.scene("test", table.views, number, None) for number in range(count)]
    return edited_scenes(model, [each.samples[0].context.images[0] for each in scenes])


def _test_names(work: Work, table: Table) -> Sequence[str]:
    return work.scenes("test", table.views).names if table.number in (1, 2) else []


def _notes(work: Work) -> tuple[str, ...]:
    notes: list[str] = []
    if work.schedule.of == "rooms":
        notes.append("Rendered rooms, not ScanNet: compare rows with each other, not the paper's.")
    if work.schedule.quick:
        notes.insert(0, "QUICK: toy sizes that show that all parts fit; the figures mean nothing.")
    if work.lpips is None:
        notes.append("LPIPS was not measured: no weights were given (--lpips).")
    return tuple(notes)
