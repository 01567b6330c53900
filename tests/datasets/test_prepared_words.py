from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from instok3d.data.words import ObjectWords
from instok3d.datasets.prepared import (
    PreparedFrame,
    PreparedScenes,
    SceneInfo,
    refresh_index,
    write_scene,
)
from instok3d.datasets.scannet.labels import TABLE
from prepared_scenes import made_folder, made_frame

ROWS = "id\traw_category\tnyu40class\n2\tChair\tchair\n5\tcoffee table\ttable\n"


def labelled(number: int, ids: list[list[int]], labels: list[list[int]]) -> PreparedFrame:
    return replace(
        made_frame(number, (2, 3)),
        instances=np.array(ids, np.uint16),
        labels=np.array(labels, np.uint16),
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    frames = [
        labelled(0, [[1, 1, 0], [2, 2, 3]], [[2, 5, 2], [5, 0, 77]]),
        labelled(1, [[1, 1, 4], [0, 0, 0]], [[2, 2, 0], [2, 2, 2]]),
    ]
    write_scene(tmp_path, SceneInfo("a", "scannet", "train", "metre"), frames)
    refresh_index(tmp_path)
    return tmp_path


def test_instances_have_the_word_of_most_of_their_labelled_pixels(folder: Path):
    """Of instance 3 the label is not in the table, of 4 there is none."""
    (folder / TABLE).write_text(ROWS)
    words = PreparedScenes(folder).frames(0, [0, 1]).words
    assert words == {
        1: ObjectWords("chair", nyu40="chair"),
        2: ObjectWords("coffee table", nyu40="table"),
    }
    assert PreparedScenes(folder).frames(0, []).words == {}


def test_without_the_table_nobody_knows_words(folder: Path):
    assert PreparedScenes(folder).frames(0, [0, 1]).words == {}


def test_scenes_without_labels_have_no_words(tmp_path: Path):
    made_folder(tmp_path, {"a": "train"})
    (tmp_path / TABLE).write_text(ROWS)
    assert PreparedScenes(tmp_path).frames(0, [0]).words == {}
