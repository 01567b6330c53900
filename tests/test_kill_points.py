"""Copies before each operation against processes that are really killed there."""

import shutil
from pathlib import Path

import pytest

from instok3d.files import replacing_folder
from kill_points import contents, every_kill, killed_at


def write(folder: Path) -> None:
    """Replaces a folder, and leaves text of which the system has not heard yet."""
    with replacing_folder(folder / "scene") as part:
        (part / "deep").mkdir()
        (part / "deep" / "a.txt").write_text("new")
    with open(folder / "b.txt", "w") as file:
        file.write("half")
        (folder / "c.txt").touch()


def test_copies_are_what_real_kills_leave(tmp_path: Path):
    def prepare() -> Path:
        shutil.rmtree(tmp_path / "work", ignore_errors=True)
        (tmp_path / "work" / "scene").mkdir(parents=True)
        (tmp_path / "work" / "scene" / "a.txt").write_text("old")
        return tmp_path / "work"

    kills = []
    while killed_at(len(kills) + 1, folder := prepare(), write):
        kills.append(contents(folder))
    whole = contents(folder)
    assert kills[-1]["b.txt"] == b""
    assert whole["b.txt"] == b"half"
    for step in (1, 3):
        left = [*kills[::step], whole]
        distinct = [
            each for each, before in zip(left, [None, *left], strict=False) if each != before
        ]
        assert [contents(folder) for folder in every_kill(prepare, write, step)] == distinct


def test_what_fails_is_no_kill(tmp_path: Path):
    def fail(folder: Path) -> None:
        raise ValueError("no")

    with pytest.raises(AssertionError, match="failed"):
        next(every_kill(lambda: tmp_path, fail))


def test_a_function_of_no_operations_is_told(tmp_path: Path):
    with pytest.raises(AssertionError, match="hardly anything"):
        next(every_kill(lambda: tmp_path, lambda folder: None))
