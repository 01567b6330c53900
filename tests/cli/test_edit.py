"""`instok3d edit` as people type it."""

import json
import shlex
from pathlib import Path

import pytest

import instok3d
from edited_scenes import assert_bit_equal
from instok3d.cli import main
from instok3d.scene.previews import save_with_previews
from instok3d.scene.scene import Scene
from made_scene import made_scene, made_tokens


@pytest.fixture
def room(tmp_path: Path) -> Path:
    made_scene(made_tokens()).save(tmp_path / "room.itk")
    return tmp_path / "room.itk"


def test_edits_grow_the_log_and_are_undone_and_redone(room: Path, capsys):
    source = instok3d.load(room)
    words = [
        "rename 3 'blue ball'", "move object#1 --by -0.1 0 0.2", "rotate 1 --yaw 30",
        "scale 1 --factor 1.5", "duplicate 1 --by 0 0.3 0", "recolor 5 --color lime",
        f"insert {room}:3 --at 0 0 2", "hide 5", "show 5", "merge 1 5",
        "split 1 --box -9 -9 -9 9 0.1 9", "remove 3", "only 1 6",
    ]  # fmt: skip
    for number, line in enumerate(words, 1):
        certify = ["--certify"] * (number % 4 == 2)
        assert main(["edit", str(room), *shlex.split(line), *certify]) == 0, line
        out = capsys.readouterr().out
        assert f"\n{number} edit{'s' * (number > 1)}, " in f"\n{out}"
        assert ("outside of what was edited: 0" in out) == bool(certify)
    edited = instok3d.load(room)
    assert [item.id for item in edited.objects] == [1, 6]
    for _ in words:
        assert main(["edit", str(room), "undo"]) == 0
    assert_bit_equal(instok3d.load(room), source)
    assert main(["edit", str(room), "undo"]) == 2
    assert "nothing to undo" in capsys.readouterr().err
    assert main(["edit", str(room), "redo"]) == 0
    assert main(["edit", str(room), "log"]) == 0
    out = capsys.readouterr().out
    assert "   1 rename object#3: blue ball" in out
    assert out.count("undone: ") == len(words) - 1


def test_previews_that_are_there_show_the_edited_scene(tmp_path: Path):
    save_with_previews(made_scene(made_tokens()), tmp_path / "room.itk")
    sheet = tmp_path / "room.itk/previews/contact_sheet.png"
    before = sheet.read_bytes()
    assert main(["edit", str(tmp_path / "room.itk"), "remove", "1"]) == 0
    assert sheet.read_bytes() != before
    assert not (sheet.parent / "objects/001.png").exists()
    assert main(["edit", str(tmp_path / "room.itk"), "undo"]) == 0
    assert sheet.read_bytes() == before


def test_output_writes_another_scene_and_leaves_this_one(room: Path, tmp_path: Path, capsys):
    before = {file: file.read_bytes() for file in room.rglob("*") if file.is_file()}
    other, said = tmp_path / "other.itk", tmp_path / "said.txt"
    line = ["edit", str(room), "remove", "1", "-o", str(other), "--json", "--disclose", str(said)]
    assert main(line) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["edits"] == ["remove object#1"]
    assert before == {file: file.read_bytes() for file in room.rglob("*") if file.is_file()}
    assert_bit_equal(instok3d.load(other).undo(), instok3d.load(room))
    assert_bit_equal(Scene.load(other, edits=False), instok3d.load(room))
    assert "1. remove object#1" in said.read_text()
    assert answer["source_sha256"] in said.read_text()
    assert (other / "previews/contact_sheet.png").is_file()


def test_info_and_exports_say_that_a_scene_was_edited(room: Path, tmp_path: Path, capsys):
    for words in (["hide", "3"], ["move", "1", "--by", "0", "0", "1"]):
        assert main(["edit", str(room), *words]) == 0
    capsys.readouterr()
    assert main(["info", str(room)]) == 0
    line = f"edited: 2 operations, source sha256 {instok3d.load(room).provenance.edited_from}"
    out = capsys.readouterr().out
    assert line in out
    assert "hidden" in out
    assert main(["export", str(room), "-o", str(tmp_path / "room.ply")]) == 0
    head = (tmp_path / "room.ply").read_bytes()[:1000]
    assert line.encode() in head
    assert b"element vertex 32" in head


WRONG = {
    "no object 2 in this scene": "remove 2",
    "--yaw is no option of hide, but of: move": "hide 1 --yaw 3",
    "rotate needs --yaw": "rotate 1",
    "move needs --by, --yaw or --factor": "move 1",
    "recolor needs --color": "recolor 1",
    "scale must be a number above 0": "scale 1 --factor 0",
    "by must be three finite numbers": "move 1 --by nan 0 0",
    "remove takes at least one object, got none": "remove",
    "rename takes an object and a label, got 1": "rename 1",
    "move takes one object, got 1, 3": "move 1 3 --by 0 0 1",
    "undo takes no objects, got 1": "undo 1",
    "insert takes a scene and an object, such as other.itk:7": "insert 7 --at 0 0 0",
    "nowhere.itk is not a scene folder": "insert nowhere.itk:7 --at 0 0 0",
    "two or more different objects": "merge 1 1",
    "nothing to redo": "redo",
    "'blurple' is no colour": "recolor 1 --color blurple",
}


@pytest.mark.parametrize("sentence", WRONG)
def test_what_cannot_be_done_is_said_in_one_line_and_changes_nothing(
    sentence: str, room: Path, capsys
):
    before = {file: file.read_bytes() for file in room.rglob("*") if file.is_file()}
    assert main(["edit", str(room), *WRONG[sentence].split()]) == 2
    found = capsys.readouterr().err.strip()
    assert sentence in found
    assert len(found.splitlines()) == 1
    assert before == {file: file.read_bytes() for file in room.rglob("*") if file.is_file()}


def test_a_scene_that_is_not_there_and_an_output_that_is(tmp_path: Path, room: Path, capsys):
    assert main(["edit", str(tmp_path / "none.itk"), "remove", "1"]) == 2
    assert "is not a scene folder" in capsys.readouterr().err
    assert main(["edit", str(room), "remove", "1", "-o", str(room)]) == 2
    assert "already there" in capsys.readouterr().err
