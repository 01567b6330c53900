"""`instok3d describe` as people type it."""

import json
from pathlib import Path

import pytest

import instok3d
from instok3d.cli import main
from made_scene import made_empty_scene, made_scene, made_tokens


@pytest.fixture
def room(tmp_path: Path) -> Path:
    made_scene(made_tokens()).rename(1, "ball").save(tmp_path / "room.itk")
    return tmp_path / "room.itk"


def test_text_and_json_say_the_same(room: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["describe", str(room)]) == 0
    text = capsys.readouterr().out
    assert text.rstrip("\n") == str(instok3d.load(room).describe())
    assert main(["describe", str(room), "--json"]) == 0
    value = json.loads(capsys.readouterr().out)
    assert value["text"] == text.rstrip("\n")
    assert (value["format"], value["version"]) == ("instok3d-description", 1)
    assert [each["key"] for each in value["objects"]] == ["ball#1", "object#3"]


def test_scale_up_and_number_are_those_that_were_given(room: Path, capsys):
    words = ["--json", "--scale", "known:ball=0.5", "--up=-y", "--most", "2"]
    assert main(["describe", str(room), *words]) == 0
    value = json.loads(capsys.readouterr().out)
    assert value["units"] == "metres"
    assert value["up_confidence"] == 1.0
    # The known height is that of the oriented box, which is not the upright one's.
    height = instok3d.load(room).object("ball").height_along((0.0, -1.0, 0.0))
    assert value["metres_per_scene_unit"] == pytest.approx(0.5 / height)


def test_an_empty_scene_is_described(tmp_path: Path, capsys):
    made_empty_scene().save(tmp_path / "empty.itk")
    assert main(["describe", str(tmp_path / "empty.itk")]) == 0
    assert capsys.readouterr().out.startswith("A scene of 0 objects, seen in 1 photo.")


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--most", "0"], "most must be at least 1 object, got 0"),
        (["--scale", "known:x=1"], "no object 'x'"),
        (["--up", "sideways"], "up must be an axis"),
    ],
)
def test_what_cannot_be_described_is_one_sentence(
    room: Path, words: list[str], reason: str, capsys
):
    assert main(["describe", str(room), *words]) == 2
    error = capsys.readouterr().err
    assert reason in error
    assert error.count("\n") == 1
