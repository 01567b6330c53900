import json
from pathlib import Path

import pytest

from instok3d.hub.manifest import ALLOWED, FORMAT, Manifest, manifest_of, read_manifest

DIGEST = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"  # of b"test"


def written(path: Path, **changes: object) -> Path:
    value = {"format": FORMAT, "kind": "model",
             "files": {"model.safetensors": {"sha256": DIGEST, "bytes": 4}}}  # fmt: skip
    file = path / "instok3d.json"
    file.write_text(json.dumps(value | changes))
    return file


def test_a_manifest_says_what_the_files_are_and_comes_back(tmp_path: Path):
    (tmp_path / "a").write_bytes(b"test")
    made = manifest_of("model", {"model.safetensors": tmp_path / "a"})
    (tmp_path / "instok3d.json").write_text(made.to_json())
    assert read_manifest(tmp_path / "instok3d.json", "model", "x") == made
    assert read_manifest(written(tmp_path), "model", "x") == made
    assert manifest_of("scene", {}) == Manifest("scene", {})


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"format": "instok3d-hub-2"}, "its format is 'instok3d-hub-2'"),
        ({"kind": "scene"}, "it holds a scene, wanted a model"),
        ({"kind": "code"}, "'code' is none of"),
        ({"files": {}}, "it lacks model.safetensors"),
        ({"files": {"model.bin": {}}}, "names 'model.bin', which is no file of a model"),
        ({"files": {"model.safetensors": {"sha256": "x", "bytes": 4}}}, "the SHA-256 of"),
        ({"files": {"model.safetensors": {"sha256": DIGEST, "bytes": -1}}}, "no whole number"),
        ({"files": {"model.safetensors": {"bytes": 4}}}, "lacks 'sha256'"),
        ({"files": None}, "damaged"),
    ],
)
def test_what_is_no_manifest_of_a_model_is_named(tmp_path: Path, changes: dict, said: str):
    with pytest.raises(ValueError, match=said) as caught:
        read_manifest(written(tmp_path, **changes), "model", "hub:ada/rooms")
    assert "hub:ada/rooms" in str(caught.value)


@pytest.mark.parametrize(
    "name",
    ["../scene.json", "/scene.json", "inputs/../a.png", "inputs/a.png", "scene.json\n", "a.py",
     "tokens.pt", "semantics/x.pkl", "semantics/../x.safetensors", "edits\\x.safetensors",
     "previews/objects/001.png", "scenexjson", "", "semantics/a/b.safetensors"],
)  # fmt: skip
def test_no_other_file_is_one_of_a_scene(name: str):
    assert not ALLOWED["scene"].fullmatch(name)


def test_the_files_of_scenes_are():
    names = ["scene.json", "edits.jsonl", "edits/0a.safetensors", "semantics/rooms-1.safetensors",
             "inputs/000.png", "previews/inputs/000.png", "previews/contact_sheet.png"]  # fmt: skip
    assert all(ALLOWED["scene"].fullmatch(name) for name in names)


def test_a_manifest_that_was_cut_is_refused(tmp_path: Path):
    whole = written(tmp_path).read_text()
    for length in range(len(whole)):
        (tmp_path / "instok3d.json").write_text(whole[:length])
        with pytest.raises(ValueError, match="is damaged"):
            read_manifest(tmp_path / "instok3d.json", "model", "x")
