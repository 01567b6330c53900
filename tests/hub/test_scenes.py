"""Scenes pushed, loaded and read by commands, through a stand-in of the hub."""

import json
import shutil
from pathlib import Path

import pytest
import torch

import instok3d
from hub_server import StandIn
from instok3d.cli import main
from instok3d.hub.manifest import FILE
from instok3d.scene.hub_scene import push_scene
from instok3d.viewer.folder import SceneFolder
from made_scene import made_empty_scene, made_scene, made_tokens


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene with an edit."""
    path = tmp_path_factory.mktemp("scenes") / "room.itk"
    scene = made_scene(made_tokens())
    scene.save(path)
    assert main(["edit", str(path), "remove", "1"]) == 0
    (path / "notes.txt").write_text("not for others")
    return path


def test_a_scene_comes_back_as_it_was_with_its_edits_and_where_it_is_from(
    hub: StandIn, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    words = ["push", str(folder), "hub:ada/room", "--licence", "cc-by-4.0"]
    assert main(words) == 0
    repository = hub.repositories["dataset", "ada/room"]
    name = f"hub:ada/room@{repository.newest}"
    assert capsys.readouterr().out.endswith(f"{name}: for you alone\n")
    tree = repository.trees[repository.newest]
    assert "notes.txt" not in tree
    assert {"edits.jsonl", "semantics/made-3.safetensors", "inputs/000.png"} < set(tree)
    card = tree["README.md"].decode()
    assert "Edited: " in card
    assert 'license: "cc-by-4.0"' in card
    here, there = instok3d.load(folder), instok3d.load(name)
    assert there.provenance.hub == name
    assert here.provenance.hub == ""
    assert there.provenance.edits == here.provenance.edits != ()
    assert [item.id for item in there.objects] == [item.id for item in here.objects]
    for field, value in vars(here.gaussians).items():
        assert torch.equal(value, getattr(there.gaussians, field)), field
    assert there.undo().provenance.hub == name
    assert instok3d.Scene.load(name, edits=False).provenance.hub == name
    assert main(["import", "hub:ada/room", "-o", str(tmp_path / "copy.itk")]) == 0
    copied = instok3d.load(tmp_path / "copy.itk")
    assert copied.provenance.hub == name
    assert copied.provenance.edits == here.provenance.edits
    assert main(["edit", str(tmp_path / "copy.itk"), "undo"]) == 0


def test_commands_read_a_scene_by_its_name_and_none_edits_it(
    hub: StandIn, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    name = str(push_scene(folder, "hub:ada/room").reference)
    assert main(["info", name]) == 0
    assert f"taken from {name}" in capsys.readouterr().out
    assert main(["objects", "hub:ada/room", "--json"]) == 0
    shown = capsys.readouterr()
    assert json.loads(shown.out)["objects"]
    assert f"instok3d: note: hub:ada/room is {name}" in shown.err
    assert main(["edit", name, "remove", "3"]) == 2
    assert f"nothing is edited: take a copy (instok3d import {name} -o" in capsys.readouterr().err
    with pytest.raises(ValueError, match="nothing is edited"):
        SceneFolder(Path(name))
    assert main(["edit", name, "remove", "3", "-o", str(tmp_path / "less.itk")]) == 0
    assert main(["import", name, "-o", str(tmp_path / "x.itk"), "--match", str(folder)]) == 2


def test_a_scene_without_objects_and_one_that_is_none(
    hub: StandIn, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    made_empty_scene().save(tmp_path / "empty.itk")
    pushed = push_scene(tmp_path / "empty.itk", "hub:ada/empty")
    assert instok3d.load(str(pushed.reference)).objects == ()
    (tmp_path / "none.itk").mkdir()
    assert main(["push", str(tmp_path / "none.itk"), "hub:ada/none"]) == 2
    assert "it has no scene.json" in capsys.readouterr().err
    assert main(["push", str(tmp_path / "empty.itk"), "ada/empty"]) == 2
    assert "wanted hub:USER/NAME" in capsys.readouterr().err
    assert list(hub.repositories) == [("dataset", "ada/empty")]


@pytest.mark.filterwarnings("ignore:hub")
def test_a_page_that_asks_for_another_file_gets_none(hub: StandIn, folder: Path, cache: Path):
    pushed = push_scene(folder, "hub:ada/room")
    repository = hub.repositories["dataset", "ada/room"]
    tree = repository.trees[repository.newest]
    said = json.loads(tree[FILE])
    said["files"]["../../evil.json"] = {"sha256": "0" * 64, "bytes": 1}
    repository.commit(tree | {FILE: json.dumps(said).encode()})
    hub.asked.clear()
    with pytest.raises(ValueError, match=r"names '\.\./\.\./evil\.json', which is no file of a"):
        instok3d.load("hub:ada/room")
    assert not any("evil" in asked for asked in hub.asked)
    assert not list(cache.rglob("evil*"))
    assert instok3d.load(str(pushed.reference)).objects  # the commit before it is whole


def test_a_commit_that_is_here_is_read_without_network(
    hub: StandIn, folder: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
):
    name = str(push_scene(folder, "hub:ada/room").reference)
    first = instok3d.load(name)
    monkeypatch.setenv("HF_ENDPOINT", "http://127.0.0.1:9")
    assert len(instok3d.load(name).objects) == len(first.objects)
    with pytest.raises(ConnectionError, match="hub:ada/room cannot be had from the hub"):
        instok3d.load("hub:ada/room")
    shutil.rmtree(cache)
    with pytest.raises(ConnectionError, match="cannot be had"):
        instok3d.load(name)
