import json
from pathlib import Path

import numpy as np
import pytest

from instok3d.datasets.scannet.labels import CLASSES, TABLE, read_label_table

ROWS = "id\traw_category\tnyu40class\n1\twall\twall\n36\tdark bed\tBed\n9\tcupboard\tcabinet\n"


def test_classes_by_hand(tmp_path: Path):
    (tmp_path / TABLE).write_text(ROWS)
    table = read_label_table(tmp_path / TABLE)
    assert table.names[36] == "dark bed"
    # wall is the first class, bed (in lower case) the seventh, a cabinet and an unknown id other.
    labels = np.array([[[0, 1], [36, 9]], [[7777, 1], [0, 0]]])
    expected = [[[0, 1], [7, 8]], [[8, 1], [0, 0]]]
    np.testing.assert_array_equal(table.to_classes(labels), expected)
    assert table.to_classes(np.zeros((0, 2, 2), np.int64)).shape == (0, 2, 2)


def test_scannets_own_table_gives_the_classes_of_the_protocol(shared: Path):
    table = read_label_table(shared / "data" / "protocol" / TABLE)
    protocol = json.loads((shared / "data" / "protocol" / "lsm_protocol.json").read_text())
    assert list(CLASSES) == protocol["classes"]
    expected = {int(raw): number for raw, number in protocol["raw_id_to_class"].items()}
    assert {raw: table.class_of(raw) for raw in expected} == expected
    assert len(table.names) == 549
    assert table.names[2] == "chair"  # "stack of chairs" comes later with the same id


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not ScanNet's label table"),
        ("id\tname\n1\twall\n", "not ScanNet's label table"),
        (ROWS + "x\ty\tz\n", "the id 'x'"),
    ],
)
def test_other_tables_are_refused(tmp_path: Path, text: str, message: str):
    (tmp_path / TABLE).write_text(text)
    with pytest.raises(ValueError, match=message):
        read_label_table(tmp_path / TABLE)


def test_a_missing_table_is_named(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match=TABLE):
        read_label_table(tmp_path / TABLE)
