from dataclasses import replace

import pytest

from instok3d.evaluation.differences import Difference
from instok3d.tables.cells import Cell
from instok3d.tables.definitions import Column, Row, Table, Tokenizer
from instok3d.tables.filled import (
    FilledRow,
    FilledTable,
    as_json,
    as_latex,
    as_markdown,
    escaped,
)

CELL = Cell(
    figures={"psnr": 20.5, "ap": 0.25, "lpips": 0.3}, method="m", scenes=2,
    scenes_sha256="a" * 64, weights_sha256=["b" * 64, "d" * 64], command="instok3d tables 2",
    commit="c" * 40, machine="one core", seed=3, hours=0.5, training_hours=2.0,
)  # fmt: skip
COLUMNS = (
    Column("psnr", "PSNR", 1), Column("ap", "AP", 2), Column("lpips", "LPIPS", 1, "down"),
)  # fmt: skip


def row(label: str, bound: bool = False, **figures: float | None) -> FilledRow:
    cell = replace(CELL, figures={**CELL.figures, **figures})
    made = Row(label, Tokenizer("joint"), upper_bound=bound, kind="feed-forward")
    return FilledRow(made, {"views": cell}, {"views": "cells/views-1.json"})


def filled(*rows: FilledRow) -> FilledTable:
    table = Table(2, "A title", 8, COLUMNS, tuple(each.row for each in rows))
    return FilledTable(table, rows)


def test_the_best_rows_are_bold_and_upper_bounds_are_not_compared():
    table = filled(row("one", psnr=20.0, lpips=0.2), row("two"), row("all", True, psnr=30.0))
    assert table.best() == {(1, 0), (0, 1), (1, 1), (0, 2)}  # equal ones are both best
    lines = as_markdown(table).splitlines()
    assert lines[2] == "| type | method | PSNR | AP | LPIPS |"
    assert lines[4] == "| feed-forward | one | 20.0 | **0.25** | **0.2** |"
    assert lines[5] == "| feed-forward | two | **20.5** | **0.25** | 0.3 |"
    assert lines[6] == "| feed-forward | all (upper bound) | 30.0 | 0.25 | 0.3 |"
    assert filled(row("alone")).best() == set()
    seen = row("sees the target", psnr=40.0)
    seen = replace(seen, row=replace(seen.row, compared=False))
    assert filled(row("one"), row("two", psnr=20.0), seen).best() >= {(0, 0)}
    assert not any(number == 2 for number, _ in filled(row("one"), row("two"), seen).best())


def test_rows_are_compared_with_the_reference_where_they_can_be():
    ours, other = row("ours"), row("other")
    found = {"psnr": Difference(-1.25, 0.5), "lpips": Difference(0.1, 0.0)}
    other = replace(other, differences=found)
    lines = as_markdown(filled(other, ours)).splitlines()
    start = lines.index("| method | PSNR | LPIPS |")
    assert lines[start + 2] == "| other | -1.2 ± 0.5 | +0.1 ± 0.0 |"
    assert not lines[start + 3]
    assert "± the standard error" not in as_markdown(filled(ours))
    known = [each["minus_reference"] for each in as_json(filled(other, ours))["rows"]]
    assert known[0]["psnr"] == {"value": -1.25, "standard_error": 0.5}
    assert known[1] == {}


def test_every_row_says_where_it_comes_from():
    (line,) = (x for x in as_markdown(filled(row("one"))).splitlines() if x.startswith("- one"))
    assert line == (
        "- one, views: 2 scenes, list aaaaaaaaaaaa, weights bbbbbbbbbbbb + dddddddddddd, seed 3, "
        "0.50 h + 2.00 h training, ccccccccc, one core, `instok3d tables 2`"
    )
    cell = as_json(filled(row("one")))["rows"][0]["cells"]["views"]
    assert cell["scenes_sha256"] == "a" * 64
    assert cell["command"] == "instok3d tables 2"


def test_a_figure_that_is_missing_is_an_error_and_not_a_blank():
    for write in (as_markdown, as_latex, as_json):
        with pytest.raises(ValueError, match=r"Table 2, row 'two' has no AP: cells/views-1.json"):
            write(filled(row("one"), row("two", ap=None)))


def test_what_a_method_cannot_have_is_said_to_be_nothing():
    no_masks = replace(row("3dgs", ap=None).row, without=frozenset({"ap"}))
    made = replace(row("3dgs", ap=None), row=no_masks)
    assert "| 3dgs | 20.5 | -- | 0.3 |" in as_markdown(filled(made))
    assert r"3dgs & 20.5 & -- & 0.3 \\" in as_latex(filled(made))


def test_latex_shows_every_letter_as_it_is():
    assert escaped(r"50 % & #1 a_b {x} $ ~ ^ \n") == (
        r"50 \% \& \#1 a\_b \{x\} \$ \textasciitilde{} \textasciicircum{} \textbackslash{}n"
    )
    text = as_latex(filled(row("a_b & c", psnr=21.0), row("two")))
    assert r"feed-forward & a\_b \& c & \textbf{21.0} & \textbf{0.25} & \textbf{0.3} \\" in text
    assert r"Type & Method & PSNR$\uparrow$ & AP$\uparrow$ & LPIPS$\downarrow$ \\" in text
    assert text.count(r"\begin{tabular}{llccc}") == text.count(r"\end{tabular}") == 1


def test_a_table_without_rows_has_a_head():
    empty = filled()
    assert empty.figures() == []
    assert "| method | PSNR | AP | LPIPS |" in as_markdown(empty)
    assert as_json(empty)["rows"] == []
