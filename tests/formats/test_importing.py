import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import instok3d
from instok3d.cli import main
from instok3d.formats.importing import import_scene
from instok3d.formats.ply import write_ply
from instok3d.formats.registry import ExportOptions, export_scene, read_splats
from instok3d.formats.sidecar import sidecar_path
from instok3d.geometry.cameras import rigid
from instok3d.geometry.moving import move_gaussians
from instok3d.geometry.rotations import quat_to_matrix
from splat_scenes import camera, furnished_scene, psnr


@pytest.mark.parametrize("suffix", [".ply", ".glb", ".splat", ".spz"])
def test_what_was_exported_is_a_scene_again_with_its_objects(tmp_path: Path, suffix: str):
    scene = furnished_scene()
    first = replace(scene.objects[0], label="red box")
    scene = replace(scene, objects=(first, *scene.objects[1:]))
    export_scene(scene, tmp_path / f"a{suffix}", ExportOptions(with_ids=True))
    again = import_scene(tmp_path / f"a{suffix}")
    assert [item.id for item in again.objects] == [item.id for item in scene.objects]
    assert [len(again.part(item.id).means) for item in again.objects] == [
        item.num_gaussians for item in scene.objects
    ]
    if suffix != ".ply":
        assert again.objects[0].label == "red box"
    assert again.vertical.up == pytest.approx((0, -1, 0))
    pictures = [each.render(camera(), 96, 96, only=1).colors for each in (scene, again)]
    assert psnr(*pictures) >= 30


def test_a_sidecar_of_another_file_is_not_believed(tmp_path: Path):
    export_scene(furnished_scene(100), tmp_path / "a.spz")
    export_scene(furnished_scene(200), tmp_path / "b.spz")
    sidecar_path(tmp_path / "b.spz").replace(sidecar_path(tmp_path / "a.spz"))
    splats = read_splats(tmp_path / "a.spz")
    assert not splats.object_ids.any()
    assert "belongs to another version of a.spz" in splats.notes[0]


def test_what_lies_in_a_sidecars_place_is_kept(tmp_path: Path):
    scene, file = furnished_scene(100), tmp_path / "a.spz"
    sidecar_path(file).write_text('{"mine": 1}')
    for overwrite in (False, True):
        with pytest.raises(FileExistsError, match=r"a\.spz\.json"):
            export_scene(scene, file, ExportOptions(overwrite=overwrite))
    assert sidecar_path(file).read_text() == '{"mine": 1}'
    assert not file.exists()
    sidecar_path(file).unlink()
    for _ in range(2):
        export_scene(scene, file, ExportOptions(overwrite=True))


def test_a_damaged_sidecar_is_named(tmp_path: Path):
    export_scene(furnished_scene(100), tmp_path / "a.spz")
    file = sidecar_path(tmp_path / "a.spz")
    value = json.loads(file.read_text())
    value["objects"][0]["gaussian_range"] = [90, 20]
    file.write_text(json.dumps(value))
    with pytest.raises(ValueError, match=r"a\.spz\.json is damaged"):
        read_splats(tmp_path / "a.spz")


def test_a_file_that_was_edited_elsewhere_gets_its_objects_back(tmp_path: Path):
    scene = furnished_scene(400)
    # Another program removed every third Gaussian, turned the rest and forgot the order.
    generator = torch.Generator().manual_seed(1)
    rows = torch.randperm(400, generator=generator)
    rows = rows[rows % 3 > 0]
    turn = rigid(quat_to_matrix(torch.tensor([0.8, 0.6, 0.0, 0.0])), torch.tensor([1.0, 2, 3]))
    write_ply(tmp_path / "edited.ply", move_gaussians(scene.gaussians.rows(rows), turn))
    again = import_scene(tmp_path / "edited.ply", match=scene)
    wanted = scene.object_ids()[rows]
    assert [item.num_gaussians for item in again.objects] == [
        int((wanted == item.id).sum()) for item in scene.objects
    ]
    write_ply(tmp_path / "other.ply", furnished_scene(400, sh_count=1).gaussians.rows(
        slice(0, 0)))  # fmt: skip
    with pytest.raises(ValueError, match=r"other\.ply holds no Gaussians"):
        import_scene(tmp_path / "other.ply", match=scene)


def test_a_file_of_another_scene_is_not_matched(tmp_path: Path):
    scene = furnished_scene(100)
    other = replace(scene.gaussians, opacities=1 - scene.gaussians.opacities)
    write_ply(tmp_path / "other.ply", other)
    with pytest.raises(ValueError, match=r"only \d+ of 100 Gaussians of .*other\.ply are in"):
        import_scene(tmp_path / "other.ply", match=scene)


def test_the_command_imports_a_folder_of_groups(tmp_path: Path, capsys):
    scene = furnished_scene(200)
    (tmp_path / "groups").mkdir()
    for item in scene.objects:
        write_ply(tmp_path / f"groups/thing_{item.id}.ply", scene.part(item.id))
    room = str(tmp_path / "room.itk")
    assert main(["import", str(tmp_path / "groups"), "-o", room]) == 0
    assert "and 2 objects written" in capsys.readouterr().out
    loaded = instok3d.load(room)
    assert [item.label for item in loaded.objects] == ["thing_1", "thing_2"]
    assert main(["import", str(tmp_path / "groups"), "-o", room]) == 2
    assert main(["export", room, "-o", str(tmp_path / "again.spz")]) == 0
    assert main(["export", room, "--per-object", str(tmp_path / "objects")]) == 0
    assert main(["import", str(tmp_path / "none.ply"), "-o", room, "--overwrite"]) == 2
