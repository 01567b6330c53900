"""ScanNet's label table: raw ids to the eight classes of the LSM protocol."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int, UInt8

CLASSES = ("wall", "floor", "ceiling", "chair", "table", "sofa", "bed", "other")
"""Of LSM's evaluation; class c is number c + 1, and 0 is ignored."""
OTHER = len(CLASSES)
TABLE = "scannetv2-labels.combined.tsv"


@dataclass(frozen=True)
class LabelTable:
    """What each raw label id of ScanNet stands for."""

    names: dict[int, str]
    """raw_category; of the several that share an id, the first."""
    nyu40_names: dict[int, str]
    """nyu40class, as the table writes it."""

    def class_of(self, raw_id: int) -> int:
        """1 to 8 by the exact nyu40class in lower case, others 8; 0 (ignore) for raw id 0."""
        if raw_id == 0:
            return 0
        name = self.nyu40_names.get(raw_id, "").lower()
        return CLASSES.index(name) + 1 if name in CLASSES else OTHER

    def to_classes(
        self, labels: Int[np.ndarray, "*batch height width"]
    ) -> UInt8[np.ndarray, "*batch height width"]:
        """`class_of` for every pixel of raw label maps."""
        raw_ids, places = np.unique(labels, return_inverse=True)
        classes = np.array([self.class_of(int(raw_id)) for raw_id in raw_ids], dtype=np.uint8)
        return classes[places].reshape(labels.shape)


def read_label_table(path: Path) -> LabelTable:
    """Read scannetv2-labels.combined.tsv.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It lacks a column or has a row without a whole number as id.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no label table {path}; it comes with ScanNet as {TABLE}")
    with path.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream, delimiter="\t"))
    wanted = ("id", "raw_category", "nyu40class")
    if not rows or any(name not in rows[0] for name in wanted):
        raise ValueError(f"{path} is not ScanNet's label table: wanted the columns {wanted}")
    wrong = [row["id"] for row in rows if not (row["id"] or "").isdecimal()]
    if wrong:
        raise ValueError(f"{path} has the id {wrong[0]!r}, wanted a whole number")
    rows.reverse()  # of rows with the same id the first one of the file then stays
    return LabelTable(
        names={int(row["id"]): row["raw_category"] or "" for row in rows},
        nyu40_names={int(row["id"]): row["nyu40class"] or "" for row in rows},
    )
