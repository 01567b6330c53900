"""`instok3d query`, and objects named in words in other commands, as people type it."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import instok3d
from instok3d.cli import main
from instok3d.semantics.query import shipped
from made_encoder import made_room, write_encoder
from made_scene import HEIGHT, WIDTH


@pytest.fixture
def room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A red chair (1) and a white lamp (3), and the weights of the encoder that saw them."""
    weights = tmp_path / "default_semantics.safetensors"
    made_room(write_encoder(weights)).save(tmp_path / "room.itk")
    monkeypatch.setattr(shipped, "SHIPPED", weights)
    return tmp_path / "room.itk"


def said(capsys: pytest.CaptureFixture[str]) -> str:
    return capsys.readouterr().out


def test_a_question_is_answered_with_what_was_understood(room: Path, capsys):
    assert main(["query", str(room), "the red chair"]) == 0
    first, second = said(capsys).splitlines()
    assert first == "understood: one object like 'chair', colour red"
    assert second.split()[:2] == ["1", "object#1"]
    assert main(["query", str(room), "the white chair"]) == 0
    assert said(capsys).splitlines()[1].startswith("not present (closest: object#1 ")


def test_json_holds_answers_boxes_and_what_comes_closest(room: Path, capsys):
    assert main(["query", str(room), "all lamps", "--json"]) == 0
    value = json.loads(said(capsys))
    assert (value["present"], value["several"], value["encoder"]) == (True, True, "rooms-1")
    (answer,) = value["answers"]
    assert (answer["id"], answer["key"]) == (3, "object#3")
    assert answer["probability"] >= value["threshold"]
    assert answer["obb"]["size"] == list(instok3d.load(room).object(3).obb.size)
    assert main(["query", str(room), "oven", "--json"]) == 0
    value = json.loads(said(capsys))
    assert (value["present"], value["answers"]) == (False, [])
    assert [each["id"] for each in value["closest"]]


def test_a_picture_can_be_asked_for(room: Path, tmp_path: Path, capsys):
    Image.new("RGB", (40, 30), (200, 30, 30)).save(tmp_path / "red.png")
    assert main(["query", str(room), "--image", str(tmp_path / "red.png"), "--json"]) == 0
    value = json.loads(said(capsys))
    assert value["understood"] == "one object like the picture"
    (tmp_path / "none.png").write_bytes(b"no picture")
    assert main(["query", str(room), "--image", str(tmp_path / "none.png")]) == 2
    assert "none.png" in capsys.readouterr().err


def test_heat_maps_are_pictures_of_the_photos(room: Path, tmp_path: Path, capsys):
    heat = tmp_path / "heat"
    assert main(["query", str(room), "chair", "--heatmap", str(heat)]) == 0
    assert "2 heat maps written to" in said(capsys)
    pictures = [np.array(Image.open(heat / f"00{view}.png")) for view in (0, 1)]
    assert pictures[0].shape == (HEIGHT, WIDTH, 3)
    ids = instok3d.load(room).render([0], ids=True).ids
    assert ids is not None
    redder = pictures[0][..., 0].astype(int) - pictures[0][..., 1]
    assert redder[ids[0].numpy() == 1].mean() > redder[ids[0].numpy() == 3].mean() + 20
    assert main(["query", str(room), "chair", "--heatmap", str(heat)]) == 2
    assert "already there" in capsys.readouterr().err
    assert main(["query", str(room), "chair", "--heatmap", str(heat), "--overwrite"]) == 0


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ([""], "the question is empty"),
        ([], "one of the two"),
        (["chair", "--image", "x.png"], "one of the two"),
        (["chair", "-k", "0"], "-k must be at least 1"),
        (["chair left of the lamp"], "'left' depends on where one looks from"),
        (["zebra"], "no word of 'zebra' is known"),
        (["largest object", "--heatmap", "heat"], "names no kind of thing"),
        (["chair", "--teacher", "magic:x"], "names no teacher"),
    ],
)
def test_what_cannot_be_asked_is_one_sentence(
    room: Path, words: list[str], reason: str, capsys, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(room.parent)
    assert main(["query", str(room), *words]) == 2
    error = capsys.readouterr().err
    assert reason in error
    assert error.count("\n") == 1


def test_scenes_without_semantics_and_missing_weights_are_said(
    room: Path, tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch
):
    from dataclasses import replace

    bare = tmp_path / "bare.itk"
    replace(instok3d.load(room), semantics={}).save(bare)
    assert main(["query", str(bare), "chair"]) == 2
    assert "this scene has no semantics: no encoder saw its photos" in capsys.readouterr().err
    assert main(["edit", str(bare), "remove", "the chair"]) == 2
    assert "no object 'the chair' in this scene" in capsys.readouterr().err
    monkeypatch.setattr(shipped, "SHIPPED", tmp_path / "gone.safetensors")
    assert main(["query", str(room), "chair"]) == 4
    assert "gone.safetensors is missing" in capsys.readouterr().err
    assert main(["edit", str(room), "remove", "the chair"]) == 2
    assert "no object 'the chair' in this scene" in capsys.readouterr().err


def test_objects_are_named_in_words_by_other_commands(room: Path, tmp_path: Path, capsys):
    assert main(["edit", str(room), "duplicate", "the chair", "--by", "0.3", "0", "0"]) == 0
    assert main(["edit", str(room), "remove", "chair"]) == 2
    error = capsys.readouterr().err
    assert "'chair' may mean object#1 " in error
    assert "object#5 " in error
    assert main(["export", str(room), "-o", str(tmp_path / "lamp.ply"), "--only", "the lamp"]) == 0
    count = instok3d.load(room).object(3).num_gaussians
    assert said(capsys).startswith(f"{count} Gaussians written")
    assert main(["export", str(room), "-o", str(tmp_path / "x.ply"), "--only", "all chairs"]) == 0
    assert said(capsys).startswith(f"{2 * instok3d.load(room).object(1).num_gaussians} Gaussians")
    picture = tmp_path / "chairs.png"
    assert main(["render", str(room), "-o", str(picture), "--only", "all chairs"]) == 0
    assert picture.is_file()
    assert main(["edit", str(room), "remove", "all chairs"]) == 0
    assert [item.id for item in instok3d.load(room).objects] == [3]
    assert main(["edit", str(room), "rename", "the lamp", "throne"]) == 0
    assert main(["query", str(room), "throne"]) == 0
    assert "throne#3" in said(capsys)
