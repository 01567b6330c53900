"""Rooms with catalogues: their content, their index, their credits."""

import json
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex")

from glb_files import table, write_furniture, write_textures
from instok3d.cli import BAD_INPUT, OK, main
from instok3d.files import write_json
from instok3d.rooms import RoomDataset, generate, shards
from instok3d.rooms.catalogues import models
from instok3d.rooms.catalogues.opened import Catalogues, credits_of
from instok3d.rooms.generate import generate_rooms
from instok3d.rooms.mesh import attributes
from instok3d.rooms.room import Room, build_room
from instok3d.rooms.shards import read_index

RED = np.zeros((8, 8, 3), np.uint8) + np.array([250, 0, 0], np.uint8)
MODELS = {"Chair": table(0.45, 0.45, 0.5), "Table": table(), "Desk": table(1.4, 0.6, 0.72),
          "Sofa": table(1.8, 0.8, 0.45), "Coffee cup": table(0.08, 0.08, 0.1)}  # fmt: skip
make_rooms = partial(generate_rooms, resolution=16, workers=1, level="easy", progress=False)


@pytest.fixture
def furniture(tmp_path: Path) -> Path:
    return write_furniture(tmp_path / "models", MODELS)


@pytest.fixture
def textures(tmp_path: Path) -> Path:
    files = {"red": ("floor", RED), "rose": ("wall", RED), "cherry": ("wood", RED)}
    return write_textures(tmp_path / "files", files)


@pytest.fixture
def always(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every piece that can be a model is one."""
    monkeypatch.setattr(models, "SHARE", 1.0)
    monkeypatch.setattr(models, "RARE", 0.0)


@pytest.fixture
def small_shards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shards, "SHARD_SEEDS", 1)
    monkeypatch.setattr(generate, "SHARD_SEEDS", 1)


def of_models(room: Room) -> list[dict]:
    records = attributes(room.plan.placed, room.mesh)
    return [record for record in records if record["generator"].startswith("model:")]


@pytest.mark.usefixtures("always")
def test_models_stand_where_generators_would_and_carry_things(furniture):
    catalogues = Catalogues.open(furniture)
    rooms = [build_room(seed, "medium", catalogues) for seed in range(6)]
    found = [record for room in rooms for record in of_models(room)]
    assert {record["generator"] for record in found} >= {"model:Chair", "model:Desk"}
    for record in found:
        low, high = np.array(record["aabb_m"])
        assert record["class"] in ("chair", "table", "desk", "sofa", "cup")
        assert (record["parent"] > 0) or low[2] == pytest.approx(0, abs=1e-3)
        assert high[2] - low[2] == pytest.approx(record["size_m"][2], abs=2e-3)
    on_models = [
        record
        for room in rooms
        for record in attributes(room.plan.placed, room.mesh)
        if record["parent"] and room.plan.placed[record["parent"] - 1].furniture.source
    ]
    assert on_models
    for record in on_models:
        assert record["aabb_m"][0][2] > 0.4


@pytest.mark.usefixtures("always")
def test_everyday_things_of_real_rooms_are_models_too(tmp_path):
    shoes = table(0.2, 0.3, 0.1)
    catalogues = Catalogues.open(write_furniture(tmp_path, {"Sneakers": shoes, "Plate": shoes}))
    found = [r for seed in range(2) for r in of_models(build_room(seed, "real", catalogues))]
    assert {record["class"] for record in found} <= {"shoes", "bowl"}
    assert found


def test_files_lie_on_floors_and_walls(textures):
    catalogues = Catalogues.open(textures=textures)
    kinds = set()
    for seed in range(2):
        kinds |= {m.kind for m in build_room(seed, "medium", catalogues).mesh.materials}
    assert kinds >= {"floor", "wall"}


def test_without_catalogues_a_room_is_what_it_was(furniture, textures):
    plain, again = build_room(3), build_room(3, "mix", Catalogues())
    np.testing.assert_array_equal(plain.mesh.vertices, again.mesh.vertices)
    other = build_room(3, "mix", Catalogues.open(furniture, textures))
    assert (other.room_type, other.plan.width) == (plain.room_type, plain.plan.width)


def test_a_seed_gives_the_same_room_from_a_moved_catalogue(furniture, tmp_path):
    first = Catalogues.open(furniture)
    room, record = build_room(5, "medium", first), first.record()
    (tmp_path / "elsewhere").mkdir()
    shutil.move(furniture, tmp_path / "elsewhere" / "models")
    second = Catalogues.open(tmp_path / "elsewhere" / "models")
    assert second.record() == record
    np.testing.assert_array_equal(room.mesh.vertices, build_room(5, "medium", second).mesh.vertices)


@pytest.mark.usefixtures("small_shards")
def test_a_folder_says_what_it_was_made_with_and_mixes_with_nothing_else(
    furniture, textures, tmp_path
):
    folder, both = tmp_path / "rooms", Catalogues.open(furniture, textures)
    assert make_rooms(folder, range(1, 2), catalogues=both).scenes == 1
    index = read_index(folder)["catalogues"]
    assert index == both.record()
    assert index["furniture"]["licenses"] == {"CC0-1.0": 5}
    text = (folder / "CREDITS.txt").read_text()
    for line in credits_of(index):
        assert line in text.splitlines()
    assert "Coffee cup (Coffee cup) by Ada, CC0-1.0" in text
    assert RoomDataset(folder).credits == credits_of(index)

    # Another set, a file that changed, or none: refused, and nothing is written.
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    changed = write_furniture(tmp_path / "models", {**MODELS, "Table": table(1.3)})
    for other in (Catalogues(), Catalogues.open(furniture), Catalogues.open(changed, textures)):
        with pytest.raises(ValueError, match=r"rooms made with furniture models .* not with"):
            make_rooms(folder, range(2, 3), catalogues=other)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_folder_without_catalogues_says_nothing_of_them_and_takes_none_later(furniture, tmp_path):
    index = shards.new_index(16, "easy", Catalogues().record())
    assert index == shards.new_index(16, "easy")
    write_json(tmp_path / "rooms.json", index)
    assert RoomDataset(tmp_path).credits == []
    with pytest.raises(ValueError, match="rooms made with no catalogue, not with furniture"):
        make_rooms(tmp_path, range(2, 3), catalogues=Catalogues.open(furniture))
    assert not (tmp_path / "CREDITS.txt").exists()


@pytest.mark.usefixtures("small_shards")
def test_the_command_says_how_much_is_used_and_what_is_wrong(furniture, tmp_path, capsys):
    out = ["data", "rooms", "-o", str(tmp_path / "rooms"), "--seeds", "1:2", "--resolution", "16",
           "--workers", "1", "--level", "easy", "--furniture"]  # fmt: skip
    assert main([*out, str(furniture)]) == OK
    assert "furniture: 5 of 5 used\n" in capsys.readouterr().out
    assert main([*out, str(tmp_path)]) == BAD_INPUT
    assert "there is no file" in capsys.readouterr().err
    (furniture / "Sofa.glb").write_bytes(b"")
    assert main([*out, str(furniture)]) == BAD_INPUT
    assert "Sofa.glb is damaged" in capsys.readouterr().err


def test_an_index_whose_catalogues_cannot_be_is_refused(furniture, tmp_path):
    record = Catalogues.open(furniture).record()
    for damage in (
        {"sculptures": record["furniture"]},
        {"furniture": {**record["furniture"], "credits": [3]}},
        {"furniture": {**record["furniture"], "sha256": None}},
        {"furniture": []},
        [],
    ):
        index = shards.new_index(16, "mix") | {"catalogues": damage}
        (tmp_path / "rooms.json").write_text(json.dumps(index))
        with pytest.raises(ValueError, match=r"rooms\.json is damaged"):
            read_index(tmp_path)


def test_both_kinds_can_be_left_out():
    assert Catalogues().record() == {}
    assert Catalogues().summary() == []
    assert replace(Catalogues()) == Catalogues()
