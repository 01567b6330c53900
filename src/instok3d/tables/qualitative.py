"""The paper's qualitative figures, laid out alike: rows are scenes, columns methods."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from instok3d.files import replacing
from instok3d.pictures import contact_sheet, titled_rows
from instok3d.tables.definitions import Row
from instok3d.tables.features import picture_name
from instok3d.tables.manipulation import TITLES, Picture
from instok3d.tables.picture_files import read_picture
from instok3d.tables.work import PICTURED

FIGURES = {1: "figure3_reconstruction", 2: "figure5_instances"}
"""Of the views of a table; Table 1 has FEATURE_FIGURE too."""
FEATURE_FIGURE = "figure4_features"
EDIT_FIGURE = "figure6_manipulation"


def write_figures(
    folder: Path, number: int, rows: Sequence[tuple[Row, Mapping[str, Path]]], num_scenes: int
) -> list[Path]:
    """The figures that go with a table, if any.

    Args:
        folder: They are written here.
        number: Of the table.
        rows: Each with the folders of its cells, by 'views' and 'features'.
        num_scenes: That were measured.

    Returns:
        The PNG files.
    """
    written = []
    scenes = range(min(num_scenes, PICTURED))
    rows = [(row, files) for row, files in rows if row.pictured]
    with_views = [(row, files["views"]) for row, files in rows if "views" in files]
    if number == 1 and with_views:
        columns = [(row.short or row.label, place, "render") for row, place in with_views]
        columns.append(("ground truth", with_views[0][1], "photo"))
        written.append(_sheet(folder / f"{FIGURES[1]}.png", columns, scenes))
    if number == 2 and with_views:
        first = with_views[0][1]
        columns = [(row.short or row.label, place, "masks") for row, place in with_views]
        columns += [("photo", first, "photo"), ("ground truth", first, "truth")]
        written.append(_sheet(folder / f"{FIGURES[2]}.png", columns, scenes))
    with_features = [(row, files["features"]) for row, files in rows if "features" in files]
    if number == 1 and with_features:
        first = with_features[0][1]
        columns = [("photo", first, "photo")]
        columns += [
            (row.short or row.label, place, picture_name(row.features))
            for row, place in with_features
            if row.features is not None
        ]
        columns.append(("ground truth", first, "truth"))
        written.append(_sheet(folder / f"{FEATURE_FIGURE}.png", columns, scenes))
    return written


def write_edits(folder: Path, rows: Sequence[Sequence[Picture]]) -> list[Path]:
    """The figure of edits, from rows of `manipulation.edited_scenes`; none without a row."""
    return [_written(folder / f"{EDIT_FIGURE}.png", rows, TITLES)] if rows else []


def _sheet(path: Path, columns: Sequence[tuple[str, Path, str]], scenes: range) -> Path:
    rows = [
        [read_picture(place / f"{scene:05d}_{name}.png") for _, place, name in columns]
        for scene in scenes
    ]
    return _written(path, rows, [title for title, _, _ in columns])


def _written(path: Path, rows: Sequence[Sequence[Picture]], titles: Sequence[str]) -> Path:
    sheet = contact_sheet(titled_rows(rows, titles), columns=len(titles))
    with replacing(path) as part:
        sheet.save(part, format="PNG")
    return path
