"""A library behind a real server; its scenes' own folders are not there."""

from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest

from instok3d.library.entries import Encoder
from instok3d.library.folder import FolderLibrary
from instok3d.service.library_tools import LibraryTools, short_names
from instok3d.viewer.guard import Guard
from made_encoder import MadeTeacher
from made_entries import made_entries
from served_office import ask, office_library, served, value_of

pytest.importorskip("mcp", reason="needs mcp: '.[serve]'")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("library")


@pytest.fixture(scope="module")
def guard(folder: Path) -> Iterator[Guard]:
    with served(office_library(folder)) as guard:
        yield guard


def test_scenes_have_short_names_and_come_in_parts(guard: Guard):
    found = value_of(guard, "/api/library_scenes")
    assert found == {
        "scenes": [{"name": "north/room.itk", "objects": 3},
                   {"name": "south/room.itk", "objects": 3}],
        "count": 2, "objects": 6, "encoder": "made-3",
    }  # fmt: skip
    parts = value_of(guard, "/api/library_scenes?first=1&most=1")["scenes"]
    assert parts == found["scenes"][1:]
    assert value_of(guard, "/api/library_scenes?first=2")["scenes"] == []
    assert list(value_of(guard, "/openapi.json")["paths"]) == [
        f"/api/library_{name}"
        for name in ("scenes", "query", "query_picture", "entry", "thumbnail")
    ]


def test_answers_are_those_of_the_library(guard: Guard, folder: Path):
    library = FolderLibrary(folder / "lib")
    found = value_of(guard, "/api/library_query?text=lamp&k=4")["matches"]
    wanted = library.query(np.array([0.0, 0, 1]), 4)
    assert [(f"/data/{each['scene']}", each["id"], each["score"]) for each in found] == [
        (each.scene, each.object.id, each.score) for each in wanted
    ]
    assert found[0]["box"]["max"] == wanted[0].object.box[1].tolist()


def test_an_object_and_its_picture(guard: Guard, folder: Path):
    entry = made_entries(3, 1, labels=["chair", "lamp"]).objects[2]
    where = f"scene={quote('south/room.itk', safe='')}&id=3"
    assert value_of(guard, f"/api/library_entry?{where}") == {
        "scene": "south/room.itk", "id": 3, "key": "object#3", "label": None,
        "box": {"min": [0, 0, 0], "max": [1, 2, 3]},
    }  # fmt: skip
    status, headers, body = ask(guard, f"/api/library_thumbnail?{where}")
    assert (status, headers["Content-Type"], body) == (200, "image/jpeg", entry.thumbnail)


@pytest.mark.parametrize(
    ("target", "status", "words"),
    [
        ("library_entry?scene=/data/south/room.itk&id=1", 404, "no scene '/data/south/room.itk'"),
        ("library_entry?scene=../lib/library.json&id=1", 404, "library_scenes has their names"),
        ("library_thumbnail?scene=/etc/passwd&id=0", 404, "no scene '/etc/passwd' in the library"),
        ("library_entry?scene=south/room.itk&id=9", 404, "'south/room.itk' has no object 9 in the"),
        ("library_entry?scene=south/room.itk", 400, "id is missing"),
        ("library_query?text=zebra", 409, "no word of 'zebra' is known"),
        ("library_query?text=%20", 409, "the text is empty: describe what to look for"),
        ("library_query?text=chair&k=0", 400, "k must be a whole number from 1 up to 1000"),
        ("describe", 404, "there is nothing here"),
    ],
)
def test_what_cannot_be_answered_is_one_sentence(
    guard: Guard, target: str, status: int, words: str
):
    found, _, body = ask(guard, f"/api/{target}")
    assert (found, words in body.decode()) == (status, True), body
    assert b"/data/" not in body.replace(b"'/data/south/room.itk'", b"")


def test_what_is_added_later_is_not_served(tmp_path: Path):
    tools = office_library(tmp_path)
    FolderLibrary(tmp_path / "lib").add("/data/new.itk", made_entries(1, 5, Encoder("made-3", 3)))
    assert tools.scenes(0, 10)["count"] == 2
    assert len(tools.query("lamp", 10)["matches"]) == 6


def test_without_an_encoder_or_without_scenes(tmp_path: Path):
    library = FolderLibrary.create(tmp_path / "lib")
    with pytest.raises(ValueError, match=r"no encoder for questions.*start it with --teacher"):
        LibraryTools(library, None).query("lamp", 1)
    tools = LibraryTools(library, MadeTeacher())
    assert tools.query("lamp", 1) == {"matches": []}
    assert tools.scenes(0, 10) == {"scenes": [], "count": 0, "objects": 0, "encoder": None}


def test_names_are_places_without_what_all_share():
    assert short_names(["/a/b/c.itk", "/a/d.itk"]) == ["b/c.itk", "d.itk"]
    assert short_names(["/a/b/c.itk"]) == ["c.itk"]
    assert short_names(["/a/x/c.itk", "/a/x1/c.itk"]) == ["x/c.itk", "x1/c.itk"]
    assert short_names(["C:/a/c.itk", "D:/c.itk"]) == ["C:/a/c.itk", "D:/c.itk"]
    assert short_names([]) == []
