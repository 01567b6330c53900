"""`instok3d diff` as people type it."""

import json
from pathlib import Path

import pytest

from box_room import OFFICE, box_room
from instok3d.cli import main


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    folder = tmp_path_factory.mktemp("captures")
    box_room(OFFICE).save(folder / "monday.itk")
    box_room(OFFICE, seed=1).remove("stool").save(folder / "friday.itk")
    return str(folder / "monday.itk"), str(folder / "friday.itk")


def test_text_and_json_name_what_is_gone(captures: tuple[str, str], capsys):
    assert main(["diff", *captures]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("aligned on 7 objects: ")
    assert lines[1] == "gone       stool#8"
    assert main(["diff", *captures, "--json"]) == 0
    value = json.loads(capsys.readouterr().out)
    gone = [each for each in value["changes"] if each["kind"] == "gone"]
    assert [(each["before"], each["after"]) for each in gone] == [("stool#8", None)]
    assert (value["before"], value["after"]) == captures


def test_scenes_that_cannot_be_aligned_are_one_sentence(
    captures: tuple[str, str], tmp_path: Path, capsys
):
    box_room({}).save(tmp_path / "empty.itk")
    assert main(["diff", captures[0], str(tmp_path / "empty.itk")]) == 2
    error = capsys.readouterr().err
    assert "share too few objects to be aligned" in error
    assert error.count("\n") == 1
    assert main(["diff", captures[0], str(tmp_path / "none.itk")]) == 2
    assert "none.itk" in capsys.readouterr().err
