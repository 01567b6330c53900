"""One picture of all scenes of a batch: the contact sheet of each, small."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from instok3d.files import replacing
from instok3d.pictures import Section, contact_sheet

CELL = (240, 320)
"""Height and width of a scene's sheet on the sheet, pixels."""
MOST = 400
"""Scenes on the sheet."""
NAME = "contact_sheet.jpg"


def write_summary(folder: Path, names: Sequence[str], ending: str) -> None:
    """Write contact_sheet.jpg with the previews of the first scenes, if there are some."""
    cells, labels = [], []
    for name in names[:MOST]:
        path = folder / f"{name}{ending}" / "previews" / "contact_sheet.png"
        if path.is_file():
            cells.append(_cell(path))
            labels.append(name)
    if not cells:
        return
    title = f"{len(cells)} of {len(names)} scenes"
    sheet = contact_sheet([Section(title, cells, labels)], cell_height=CELL[0], columns=6)
    with replacing(folder / NAME) as part:
        sheet.save(part, "JPEG", quality=85)


def _cell(path: Path) -> np.ndarray:
    """A picture made small, on white."""
    height, width = CELL
    with Image.open(path) as picture:
        small = picture.convert("RGB")
    small.thumbnail((width, height))
    cell = Image.new("RGB", (width, height), "white")
    cell.paste(small, ((width - small.width) // 2, (height - small.height) // 2))
    return np.asarray(cell)
