import csv
import io
import json
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import torch

from imported_scene import imported_scene
from instok3d.cli import main
from instok3d.formats.objects import find_scale, objects_csv
from instok3d.scene.object_list import SCHEMA, objects_document
from instok3d.scene.scene import Scene
from instok3d.scene.vertical import Vertical
from made_scene import made_empty_scene, made_scene, made_tokens


@pytest.fixture
def scene() -> Scene:
    return made_scene(made_tokens())


def check(data: dict) -> None:
    schema = json.loads((files("instok3d") / "assets" / SCHEMA).read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.Draft202012Validator(schema).validate(data)


def filled(mask: dict) -> np.ndarray:
    height, width = mask["size"]
    inside = np.arange(len(mask["counts"])) % 2 == 1
    return np.repeat(inside, mask["counts"]).reshape(width, height).T


def test_neighbours_are_in_the_data_where_they_were_looked_for(scene: Scene):
    low, high = scene.object(1).aabb.min, scene.object(1).aabb.max
    middle = (low[1] + high[1]) / 2
    halves = scene.split(1, box=((low[0] - 1, low[1] - 1, low[2] - 1), (high[0], middle, high[2])))
    data = objects_document(halves, None, halves.neighbours())
    check(data)
    new = halves.objects[-1].id
    first = next(each for each in data["objects"] if each["id"] == 1)
    assert [each["id"] for each in first["neighbours"]] == [new]
    assert "neighbours" not in objects_document(halves)["objects"][0]


def test_the_data_follow_the_schema_and_the_scene(scene: Scene):
    data = objects_document(scene.rename(3, "blue blob"))
    check(data)
    assert [item["id"] for item in data["objects"]] == [1, 3]
    assert (data["units"], data["metres_per_scene_unit"], data["edits"]) == ("arbitrary", None, 1)
    blue = data["objects"][1]
    assert (blue["label"], blue["label_source"], blue["key"]) == (
        "blue blob", "user", "blue blob#3",
    )  # fmt: skip
    ids = scene.render(ids=True).ids
    assert ids is not None
    for item in data["objects"]:
        assert [each["view"] for each in item["seen"]] == list(scene.object(item["id"]).visible_in)
        best = max(item["seen"], key=lambda each: each["pixels"])
        assert item["best_view"] == {key: best[key] for key in ("view", "pixels", "box")}
        for each in item["seen"]:
            mask = (ids[each["view"]] == item["id"]).numpy()
            assert (filled(each["mask"]) == mask).all()
            assert each["pixels"] == mask.sum()
            x0, y0, x1, y1 = each["box"]
            assert mask[y0:y1, x0:x1].sum() == mask.sum()


def test_no_objects_and_no_views_are_data_too(scene: Scene):
    check(objects_document(made_empty_scene()))
    assert objects_csv(made_empty_scene()).count("\n") == 1
    data = objects_document(imported_scene())
    check(data)
    assert [item["seen"] for item in data["objects"]] == [[], [], []]
    assert data["views"] == []


def test_a_known_height_makes_metres_of_all_lengths(scene: Scene):
    before, height = objects_document(scene), scene.object(1).height_along(scene.vertical.up)
    scale = find_scale(scene, "known:1=0.74")
    assert scale.metres_per_unit == pytest.approx(0.74 / height)
    after = objects_document(scene, scale)
    check(after)
    assert after["units"] == "metres"
    assert after["scale_source"] == "known: object#1 is 0.74 m high"
    assert after["objects"][0]["height"] == pytest.approx(0.74)
    for key in ("centroid", "height"):
        ratio = np.array(after["objects"][1][key]) / np.array(before["objects"][1][key])
        assert np.allclose(ratio, scale.metres_per_unit)


def test_height_is_along_up_by_hand(scene: Scene):
    box = replace(scene.object(1).obb, size=(3.0, 2.0, 1.0), quat_wxyz=(1.0, 0.0, 0.0, 0.0))
    item = replace(scene.object(1), obb=box)
    for axis, height in enumerate((3.0, 2.0, 1.0)):
        x, y, z = torch.eye(3)[axis].tolist()
        turned = replace(scene, vertical=Vertical((x, y, z), "given cameras", 1.0))
        assert item.height_along(turned.vertical.up) == pytest.approx(height)


@pytest.mark.parametrize(
    "wanted", ["known:1", "known:1=tall", "known:1=0", "known:1=-1", "known:1=nan", "known:1=1e9",
               "known:=1", "door", ""],
)  # fmt: skip
def test_what_is_no_scale_is_refused(scene: Scene, wanted: str):
    with pytest.raises(ValueError, match="none of: none, known:OBJECT=HEIGHT"):
        find_scale(scene, wanted)


def test_a_scale_needs_an_object_and_no_metres(scene: Scene):
    with pytest.raises(KeyError, match="no object 7"):
        find_scale(scene, "known:7=1")
    metric = replace(scene, units="metres")
    assert find_scale(metric).metres_per_unit == 1
    with pytest.raises(ValueError, match="in metres already"):
        find_scale(metric, "known:1=1")


def test_the_command_prints_a_table_or_json(
    tmp_path: Path, scene: Scene, capsys: pytest.CaptureFixture[str]
):
    room = tmp_path / "room.itk"
    scene.save(room)
    assert main(["objects", str(room)]) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert [row["key"] for row in rows] == ["object#1", "object#3"]
    assert main(["objects", str(room), "--json", "--scale", "known:object#1=2"]) == 0
    data = json.loads(capsys.readouterr().out)
    check(data)
    assert data["units"] == "metres"
    assert main(["objects", str(room), "--json", "--csv"]) == 2
    assert "give one of them" in capsys.readouterr().err


def test_a_scene_folder_holds_the_same_data_as_the_command_prints(
    tmp_path: Path, scene: Scene, capsys: pytest.CaptureFixture[str]
):
    room = tmp_path / "room.itk"
    scene.save(room)
    kept = json.loads((room / "objects.json").read_text())
    check(kept)
    assert main(["objects", str(room), "--json"]) == 0
    # Neighbours alone are not kept: to find them is to render the views, which saving does not.
    beside = [{"neighbours": []} for _ in kept["objects"]]
    entries = [each | more for each, more in zip(kept["objects"], beside, strict=True)]
    assert json.loads(capsys.readouterr().out) == kept | {"objects": entries}
    assert main(["info", str(room), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["objects"] == entries


def test_a_hidden_object_is_seen_as_if_it_was_not_hidden(scene: Scene):
    hidden = objects_document(scene.hide(1))["objects"][0]
    assert hidden == objects_document(scene)["objects"][0] | {"hidden": True}
