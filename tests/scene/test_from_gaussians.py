"""Scenes without photos or tokens are scenes."""

import json
from pathlib import Path

import pytest
import torch

import instok3d
from imported_scene import IMPORTED, imported_scene, made_gaussians
from instok3d.scene.from_gaussians import MAX_ID, scene_from_gaussians
from instok3d.scene.paths import camera_path
from instok3d.scene.previews import save_with_previews
from instok3d.scene.vertical import Vertical


def test_objects_keep_their_ids_and_their_gaussians_stand_together():
    scene = imported_scene()
    assert [item.id for item in scene.objects] == [2, 5, 7]
    assert [item.gaussian_range for item in scene.objects] == [(0, 10), (10, 10), (20, 10)]
    # Clusters stand at 0, 3, 6, 9 in the order 7, 0, 2, 5; each is within 1 of its place.
    for item, place in zip(scene.objects, (6, 9, 0), strict=True):
        assert abs(item.centroid[0] - place) < 1
        means = scene.part(item.id).means[:, 0]
        assert float((means - place).abs().max()) <= 1
        assert (item.best_view, item.visible_in, item.num_anchors) == (None, (), 1)
    owners = scene.tokens.assignment.argmax(dim=1)[scene.gaussians.anchor_index]
    assert owners.tolist() == [1] * 10 + [4] * 10 + [6] * 10 + [7] * 10
    assert scene.object_ids().tolist() == [2] * 10 + [5] * 10 + [7] * 10 + [0] * 10


def test_it_is_saved_loaded_and_drawn(tmp_path: Path):
    up = Vertical((0.0, 0.0, 1.0), "file", 1.0)
    scene = imported_scene(labels={5: "chair"}, units="metres", vertical=up)
    save_with_previews(scene, tmp_path / "room.itk")
    loaded = instok3d.load(tmp_path / "room.itk")
    assert loaded.objects == scene.objects
    assert (loaded.object("chair").key, loaded.vertical, loaded.frame) == ("chair#5", up, "file")
    assert json.loads((tmp_path / "room.itk/cameras.json").read_text()) == []
    assert (tmp_path / "room.itk/previews/contact_sheet.png").is_file()
    path = camera_path(loaded, "orbit", 4, 48)
    pictures = loaded.render(path.cameras, path.height, path.width, ids=True)
    assert pictures.ids is not None
    assert set(pictures.ids.unique().tolist()) == {0, 2, 5, 7}
    # All four pictures show the scene about their middle, the right way up.
    for picture in pictures.alphas:
        assert float(picture[12:-12, 16:-16].max()) > 0.5 > float(picture[:2].max())


def test_a_picture_from_its_photos_is_refused_with_what_to_do():
    scene = imported_scene()
    for draw in (scene.render, lambda: camera_path(scene, "inputs", 1), scene.render):
        with pytest.raises(ValueError, match="imported and has no input views"):
            draw()
    with pytest.raises(ValueError, match="has no photos to be refined on"):
        instok3d.refine(scene)


@pytest.mark.parametrize("ids", [(), (0,), (3,)])
def test_scenes_of_no_gaussian_no_object_and_no_rest(ids: tuple[int, ...], tmp_path: Path):
    scene = imported_scene(ids)
    assert [item.id for item in scene.objects] == [number for number in ids if number]
    save_with_previews(scene, tmp_path / "room.itk")
    assert len(instok3d.load(tmp_path / "room.itk").gaussians.means) == 10 * len(ids)


def test_ids_too_large_to_be_kept_are_numbered_anew():
    scene = imported_scene((MAX_ID + 1, 0, 9, 10**12), labels={10**12: "lamp"})
    assert [item.key for item in scene.objects] == ["object#1", "object#2", "lamp#3"]


@pytest.mark.parametrize("ids", [[1, 2], [1, 2, 3, -1]])
def test_ids_that_do_not_fit_are_refused(ids: list[int]):
    with pytest.raises(ValueError, match="one number of at least 0 for each of the 4 Gaussians"):
        scene_from_gaussians(made_gaussians(4), torch.tensor(ids), provenance=IMPORTED)


@pytest.mark.parametrize("label", ["", "  ", "a\nb", "7", "chair#1", "x" * 101])
def test_labels_that_are_none_are_refused(label: str):
    with pytest.raises(ValueError, match="label"):
        imported_scene(labels={5: label})


def test_a_label_finds_its_object_unless_several_have_it():
    scene = imported_scene(labels={5: "chair", 7: "chair", 2: "lamp"})
    assert scene.object("lamp").id == scene.object("lamp#2").id == 2
    with pytest.raises(KeyError, match="2 objects have the label 'chair'; name one of: chair#5, "):
        scene.object("chair")


def test_ids_do_not_depend_on_how_many_maps_are_drawn_at_a_time(monkeypatch: pytest.MonkeyPatch):
    scene = imported_scene()
    path = camera_path(scene, "orbit", 2)
    whole = scene.render(path.cameras, 24, 32, ids=True).ids
    monkeypatch.setattr("instok3d.scene.id_maps.COLUMNS", 3)
    parts = scene.render(path.cameras, 24, 32, ids=True).ids
    assert whole is not None
    assert parts is not None
    assert torch.equal(whole, parts)
    assert set(whole.unique().tolist()) == {0, 2, 5, 7}
