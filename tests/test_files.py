import json
from pathlib import Path

import pytest
import torch
from safetensors import safe_open

from instok3d.files import part_folder, replacing, replacing_folder, write_json, write_safetensors


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


def test_json_that_is_not_finite_is_refused_and_nothing_is_written(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", {"x": float("nan")})
    assert not list(tmp_path.iterdir())
    write_json(tmp_path / "a.json", {"x": 1.5})
    assert json.loads((tmp_path / "a.json").read_text()) == {"x": 1.5}


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


@pytest.mark.parametrize("named", [True, False])
def test_nothing_is_lost_if_the_last_rename_fails(
    tmp_path: Path, named: bool, monkeypatch: pytest.MonkeyPatch
):
    target = tmp_path / "scene"
    filled(target, "old")
    rename = Path.rename

    def fail(path: Path, to: Path) -> Path:
        if path.name.endswith(".part"):
            raise OSError("no")
        return rename(path, to)

    monkeypatch.setattr(Path, "rename", fail)
    with (
        pytest.raises(OSError, match="no"),
        replacing_folder(target, part=part_folder(target) if named else None) as part,
    ):
        filled(part, "new")
    assert (target / "a.txt").read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_what_a_killed_process_left_is_cleared_and_its_old_folder_comes_back(tmp_path: Path):
    target = tmp_path / "scene"
    filled(part_folder(target), "half")
    filled(part_folder(target).with_suffix(".old"), "old")  # killed between the two renames
    with replacing_folder(target, part=part_folder(target)) as part:
        assert list(part.iterdir()) == []
        assert (target / "a.txt").read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]
