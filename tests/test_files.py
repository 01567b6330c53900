import json
import os
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
import torch
from safetensors import safe_open

from instok3d import files, renames
from instok3d.files import (
    json_text,
    replacing,
    replacing_folder,
    sha256_of,
    write_json,
    write_safetensors,
)
from instok3d.locking import bring_back
from kill_points import every_kill


def test_a_file_appears_whole_or_not_at_all(tmp_path):
    target = tmp_path / "a.txt"
    target.write_text("old")

    def fail_halfway() -> None:
        with replacing(target) as part:
            part.write_text("half")
            raise KeyError

    with pytest.raises(KeyError):
        fail_halfway()
    assert target.read_text() == "old"
    with replacing(target) as part:
        part.write_text("new")
    assert target.read_text() == "new"
    assert [file.name for file in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("ending", [".png", f".{200 * 'x'}"])
def test_a_name_may_be_as_long_as_the_disk_allows(tmp_path, ending: str):
    target = tmp_path / ("n" * (255 - len(ending)) + ending)
    with replacing(target) as part:
        part.write_text("whole")
        assert part.suffix == ending
    assert target.read_text() == "whole"
    with replacing_folder(tmp_path / (255 * "f")) as part:
        filled(part, "whole")
    assert len(list(tmp_path.iterdir())) == 2


def test_json_that_is_not_finite_is_refused_and_nothing_is_written(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", {"x": float("nan")})
    assert not list(tmp_path.iterdir())
    write_json(tmp_path / "a.json", {"x": 1.5})
    assert json.loads((tmp_path / "a.json").read_text()) == {"x": 1.5}


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_json_with_any_name_can_be_encoded_and_read_back(encoding: str):
    plain, names = {"b": 1, "a": "caf\xe9 \u5c45"}, ["\U0001f600", "\udcff"]
    for value in (plain, names, {}):
        assert json.loads(json_text(value, encoding=encoding).encode(encoding)) == value
    assert json_text(plain) == '{\n "a": "caf\xe9 \u5c45",\n "b": 1\n}'


def test_equal_tensors_and_metadata_give_equal_bytes(tmp_path):
    tensors = {"b": torch.arange(6.0).view(2, 3).mT, "a": torch.ones(1, dtype=torch.int64)}
    about = {f"key {n}": str(n) for n in range(20)}
    for name in ("x", "y"):
        write_safetensors(tmp_path / name, tensors, about)
    assert (tmp_path / "x").read_bytes() == (tmp_path / "y").read_bytes()
    with safe_open(tmp_path / "x", framework="pt") as stored:
        assert stored.metadata() == about
        torch.testing.assert_close(stored.get_tensor("b"), tensors["b"])


def test_no_tensors_and_no_metadata_are_a_file_too(tmp_path):
    write_safetensors(tmp_path / "empty", {})
    with safe_open(tmp_path / "empty", framework="pt") as stored:
        assert list(stored.keys()) == []


def filled(folder: Path, text: str) -> None:
    folder.mkdir(exist_ok=True)
    (folder / "a.txt").write_text(text)


def test_a_folder_takes_the_place_of_the_old_one_or_leaves_it(tmp_path: Path):
    target = tmp_path / "scene"
    for text in ("first", "second"):
        with replacing_folder(target) as part:
            filled(part, text)
        assert (target / "a.txt").read_text() == text

    def interrupted() -> None:
        with replacing_folder(target) as part:
            filled(part, "third")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert (target / "a.txt").read_text() == "second"
    assert list(tmp_path.iterdir()) == [target]


def only_two_renames(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a system that cannot exchange two names."""
    monkeypatch.setattr(renames, "_renameat2", lambda: None)


@pytest.mark.parametrize("exchanging", [True, False])
def test_nothing_is_lost_if_the_last_rename_fails(
    tmp_path: Path, exchanging: bool, monkeypatch: pytest.MonkeyPatch
):
    target = tmp_path / "scene"
    filled(target, "old")
    rename = Path.rename

    def fail(*_: object) -> bool:
        raise OSError("no")

    def fail_to_come(path: Path, to: Path) -> Path:
        return fail() if path.parent.name == "new" else rename(path, to)

    if exchanging:
        monkeypatch.setattr(files, "exchange", fail)
    else:
        only_two_renames(monkeypatch)
        monkeypatch.setattr(Path, "rename", fail_to_come)
    with pytest.raises(OSError, match="no"), replacing_folder(target) as part:
        filled(part, "new")
    assert (target / "a.txt").read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def fill(folder: Path, exchanging: bool = True, text: str = "new") -> None:
    """A run of some program that writes folder/scene, which has a file in a folder too."""
    if not exchanging:
        renames._renameat2 = lambda: None
    with replacing_folder(folder / "scene") as part:
        filled(part, text)
        filled(part / "deep", text)


def write(folder: Path) -> None:
    with replacing(folder / "a.txt") as part:
        part.write_text("new")


@pytest.mark.parametrize(("exchanging", "before"), [(True, "old"), (False, "old"), (True, None)])
def test_killed_at_any_operation_it_leaves_the_old_or_the_new_folder(
    tmp_path: Path, exchanging: bool, before: str | None
):
    def prepare() -> Path:
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        folder.mkdir()
        if before:
            filled(folder / "scene", before)
        return folder

    seen = set()
    for folder in every_kill(prepare, partial(fill, exchanging=exchanging)):
        bring_back(folder / "scene")  # what a reader does
        found = folder / "scene" / "a.txt"
        seen.add(found.read_text() if found.exists() else None)
        fill(folder, text="again")
        assert (folder / "scene" / "a.txt").read_text() == "again"
        assert [path.name for path in folder.iterdir()] == ["scene"]
    assert seen == {before, "new"}


def test_killed_at_any_operation_a_file_is_the_old_or_the_new_one(tmp_path: Path):
    def prepare() -> Path:
        (tmp_path / "a.txt").write_text("old")
        return tmp_path

    seen = set()
    for folder in every_kill(prepare, write):
        seen.add((folder / "a.txt").read_text())
        write(folder)
        assert [path.name for path in folder.iterdir()] == ["a.txt"]
    assert seen == {"old", "new"}


@pytest.mark.parametrize("exchanging", [True, False])
def test_of_two_writers_of_a_new_name_the_second_is_refused(
    tmp_path: Path, exchanging: bool, monkeypatch: pytest.MonkeyPatch
):
    if not exchanging:
        only_two_renames(monkeypatch)

    def write_both(writer: Callable, target: Path) -> None:
        with writer(target, overwrite=False) as second:
            with writer(target, overwrite=False) as first:
                put(first, "first")
            put(second, "second")

    def put(path: Path, text: str) -> None:
        filled(path, text) if path.name == "scene" else path.write_text(text)

    for name, writer in (("scene", replacing_folder), ("a.txt", replacing)):
        with pytest.raises(FileExistsError, match=f"{name} has come to be there meanwhile"):
            write_both(writer, tmp_path / name)
    assert (tmp_path / "scene" / "a.txt").read_text() == "first"
    assert (tmp_path / "a.txt").read_text() == "first"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.txt", "scene"]


def test_only_files_and_folders_are_replaced(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").write_text("mine")
    for name, writer in (("pipe", replacing), ("pipe", replacing_folder),
                         ("file", replacing_folder)):  # fmt: skip
        with pytest.raises(FileExistsError, match="will not be replaced"), writer(tmp_path / name):
            pass
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "pipe"]


def test_a_second_ctrl_c_leaves_nothing_behind_either(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    target = tmp_path / "scene"
    filled(target, "old")
    remove, struck = shutil.rmtree, []

    def interrupted(path: Path, **options: bool) -> None:
        struck.append(path)
        if len(struck) == 1:
            raise KeyboardInterrupt
        remove(path, **options)

    monkeypatch.setattr(shutil, "rmtree", interrupted)
    with pytest.raises(KeyboardInterrupt), replacing_folder(target) as part:
        filled(part, "new")
    assert (target / "a.txt").read_text() == "new"
    assert list(tmp_path.iterdir()) == [target]


def test_a_name_as_long_as_names_can_be_is_written(tmp_path: Path):
    target = tmp_path / ("x" * 251 + ".txt")
    with replacing(target) as part:
        part.write_text("text")
    assert list(tmp_path.iterdir()) == [target]


def test_sha256_of_abc(tmp_path):
    (tmp_path / "abc").write_bytes(b"abc")
    digest = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert sha256_of(tmp_path / "abc") == digest
