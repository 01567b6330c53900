import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from instok3d.cli import main
from instok3d.formats.colliders import box_solid, convex_solid, write_colliders_json
from instok3d.formats.object_folder import write_object_folder
from instok3d.formats.parts import file_stem
from instok3d.formats.ply import read_ply
from instok3d.formats.registry import ExportOptions
from instok3d.scene.boxes import OrientedBox
from instok3d.scene.scene import Scene
from splat_scenes import furnished_scene


def glb_json(file: Path) -> dict:
    data = file.read_bytes()
    magic, version, length, chunk, kind = struct.unpack("<4sIIII", data[:20])
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), 0x4E4F534A)
    return json.loads(data[20 : 20 + chunk])


def test_every_object_has_its_files_and_the_index_names_them(tmp_path: Path):
    scene = furnished_scene()
    write_object_folder(tmp_path / "objects", scene, ExportOptions())
    index = json.loads((tmp_path / "objects/index.json").read_text())
    assert [each["id"] for each in index["objects"]] == [item.id for item in scene.objects]
    assert index["up"] == [0, -1, 0]
    named = {"index.json"}
    for entry, item in zip(index["objects"], scene.objects, strict=True):
        named |= set(entry["files"].values())
        alone = read_ply(tmp_path / "objects" / entry["files"]["ply"]).gaussians
        torch.testing.assert_close(alone.means, scene.part(item.id).means)
        assert entry["gaussian_range"] == [0, item.num_gaussians]
        thumbnail = Image.open(tmp_path / "objects" / entry["files"]["thumbnail"])
        assert thumbnail.size == (scene.width, scene.height)
        hull = glb_json(tmp_path / "objects" / entry["files"]["hull"])
        assert [node["name"] for node in hull["nodes"]] == [item.key]
        # y is up in the hull, down in the scene.
        low, high = hull["accessors"][0]["min"], hull["accessors"][0]["max"]
        assert low[1] < -item.centroid[1] < high[1]
    assert named == {file.name for file in (tmp_path / "objects").iterdir()}


def test_a_scene_without_objects_gives_an_index_alone(tmp_path: Path, empty_scene: Scene):
    write_object_folder(tmp_path / "objects", empty_scene, ExportOptions())
    assert [file.name for file in (tmp_path / "objects").iterdir()] == ["index.json"]


def test_a_folder_of_other_things_is_kept(tmp_path: Path, scene: Scene):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/letter.txt").write_text("dear")
    with pytest.raises(FileExistsError, match="holds other things than exported objects"):
        write_object_folder(tmp_path / "mine", scene, ExportOptions(overwrite=True))
    assert (tmp_path / "mine/letter.txt").read_text() == "dear"


@pytest.mark.parametrize(
    ("label", "stem"),
    [(None, "003"), ("Red chair", "003_red-chair"), ("../../x", "003_x"), ("椅子", "003")],
)
def test_labels_make_harmless_file_names(scene: Scene, label: str | None, stem: str):
    assert file_stem(replace(scene.object(3), label=label)) == stem


def test_a_hull_holds_its_object_and_is_closed():
    scene = furnished_scene()
    item = scene.objects[0]
    solid = convex_solid(scene, item)
    edges = {tuple(pair) for tri in solid.triangles for pair in zip(tri, np.roll(tri, -1),
                                                                   strict=True)}  # fmt: skip
    assert all((b, a) in edges for a, b in edges)
    a, b, c = (solid.vertices[solid.triangles[:, i]] for i in range(3))
    # The divergence theorem: triangles that point outwards enclose a positive volume.
    volume = (a * np.cross(b, c)).sum() / 6
    assert 0.5 * np.prod(item.obb.size) < volume <= np.prod(item.obb.size)


def test_a_box_by_hand_and_a_flat_one():
    box = box_solid(OrientedBox((1.0, 2.0, 3.0), (2.0, 4.0, 6.0), (1.0, 0.0, 0.0, 0.0)))
    assert box.vertices.min(0).tolist() == [0, 0, 0]
    assert box.vertices.max(0).tolist() == [2, 4, 6]
    assert len(box.triangles) == 12
    flat = box_solid(OrientedBox((0.0, 0.0, 0.0), (1.0, 1.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
    assert np.ptp(flat.vertices[:, 2]) == pytest.approx(1e-3)


def test_colliders_as_json_are_in_the_scenes_own_world(tmp_path: Path):
    scene = furnished_scene()
    write_colliders_json(tmp_path / "a.json", scene)
    value = json.loads((tmp_path / "a.json").read_text())
    first = value["colliders"][0]
    assert first["box"]["center"] == list(scene.objects[0].obb.center)
    assert np.allclose(np.mean(first["hull"]["vertices"], axis=0), scene.objects[0].centroid,
                       atol=0.3)  # fmt: skip


def test_the_command_writes_both_and_refuses_neither(tmp_path: Path, scene: Scene, capsys):
    scene.save(tmp_path / "room.itk")
    room, folder = str(tmp_path / "room.itk"), str(tmp_path / "objects")
    assert main(["export", room, "--per-object", folder]) == 0
    assert "2 objects written" in capsys.readouterr().out
    assert main(["export", room, "--per-object", folder]) == 2
    assert main(["export", room, "--per-object", folder, "--overwrite", "--only", "3"]) == 0
    assert len(list(Path(folder).glob("*.ply"))) == 1
    assert main(["export", room]) == 2
    assert "nothing to write" in capsys.readouterr().err


def test_hidden_objects_are_left_out_unless_asked_for_by_name(tmp_path: Path, scene: Scene):
    hidden = replace(scene.object(3), hidden=True)
    objects = tuple(hidden if item.id == 3 else item for item in scene.objects)
    made = replace(scene.provenance, edits=("hide object#3",), edited_from="0" * 64)
    replace(scene, objects=objects, provenance=made).save(tmp_path / "room.itk")
    room, file = str(tmp_path / "room.itk"), tmp_path / "a.ply"
    assert main(["export", room, "-o", str(file), "--with-ids"]) == 0
    assert read_ply(file).object_ids.unique().tolist() == [0, 1]
    assert b"comment instok3d edited: 1 operation, source sha256 0000" in file.read_bytes()
    assert main(["export", room, "-o", str(file), "--only", "3", "--overwrite"]) == 0
    assert len(read_ply(file).gaussians.means) == hidden.num_gaussians
