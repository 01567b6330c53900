"""Labels by semantics: who named an object, and what becomes of its key."""

from pathlib import Path

import pytest

import instok3d
from instok3d.scene.labels import with_labels
from instok3d.scene.object_list import objects_document
from instok3d.scene.objects import SceneObject, find_object
from instok3d.scene.scene import Scene
from instok3d.semantics.labels import ClassLabel

CHAIR, TABLE = ClassLabel("chair", 0.75), ClassLabel("table", 0.5)


@pytest.fixture
def labelled(scene: Scene) -> Scene:
    """Objects 1 and 3, both chairs by semantics."""
    return with_labels(scene, {1: CHAIR, 3: CHAIR}, "toy-1")


def names(scene: Scene) -> list[tuple[str, str | None, str | None]]:
    return [(item.key, item.label, item.label_source) for item in scene.objects]


def test_semantics_name_objects_and_their_keys(labelled: Scene):
    assert names(labelled) == [
        ("chair#1", "chair", "semantics:toy-1"), ("chair#3", "chair", "semantics:toy-1"),
    ]  # fmt: skip
    assert [item.label_score for item in labelled.objects] == [0.75, 0.75]
    entry = objects_document(labelled)["objects"][0]
    assert (entry["label_source"], entry["label_score"]) == ("semantics:toy-1", 0.75)
    assert SceneObject.from_json(entry) == labelled.objects[0]


def test_a_scene_without_labels_stays_as_it_is(scene: Scene, empty_scene: Scene):
    assert names(with_labels(scene, {}, "toy-1")) == [
        ("object#1", None, None), ("object#3", None, None),
    ]  # fmt: skip
    assert with_labels(empty_scene, {1: CHAIR}, "toy-1").objects == ()


def test_what_a_person_named_keeps_its_name(labelled: Scene):
    renamed = labelled.rename("chair#3", "throne")
    assert names(renamed)[1] == ("throne#3", "throne", "user")
    assert renamed.object(3).label_score is None
    again = with_labels(renamed, {1: TABLE, 3: TABLE}, "toy-2")
    assert names(again) == [
        ("table#1", "table", "semantics:toy-2"), ("throne#3", "throne", "user"),
    ]  # fmt: skip


def test_keys_survive_edits_undo_and_the_folder(labelled: Scene, tmp_path: Path):
    edited = labelled.move(1, (0.1, 0, 0)).duplicate(3, (0.2, 0, 0)).rename(1, "seat")
    assert names(edited) == [
        ("seat#1", "seat", "user"), ("chair#3", "chair", "semantics:toy-1"),
        ("chair#5", "chair", "semantics:toy-1"),
    ]  # fmt: skip
    edited.save(tmp_path / "room.itk")
    loaded = instok3d.load(tmp_path / "room.itk")
    assert names(loaded) == names(edited)
    assert [item.label_score for item in loaded.objects] == [None, 0.75, 0.75]
    assert names(loaded.undo().undo().undo()) == names(labelled)


def test_an_inserted_object_says_who_named_it(scene: Scene, labelled: Scene, tmp_path: Path):
    edited = scene.insert(labelled, "chair#3", (0, 0.3, 2)).insert(
        labelled.rename(1, "throne"), "throne", (0, 0.3, 3)
    )
    assert names(edited)[2:] == [
        ("chair#5", "chair", "semantics:toy-1"), ("throne#6", "throne", "user"),
    ]  # fmt: skip
    edited.save(tmp_path / "room.itk")
    assert names(instok3d.load(tmp_path / "room.itk")) == names(edited)


def test_an_object_is_found_by_its_id_as_well_once_it_has_a_label(labelled: Scene):
    assert find_object(labelled.objects, "object#3") is labelled.objects[1]
    assert find_object(labelled.objects, "chair#1") is labelled.objects[0]
    with pytest.raises(KeyError, match="2 objects have the label 'chair'; name one of: chair#1, "):
        find_object(labelled.objects, "chair")
    with pytest.raises(KeyError, match="no object 'object#2'"):
        find_object(labelled.objects, "object#2")


@pytest.mark.parametrize("source", ["nobody", "semantics:", "", "semantics:" + "x" * 100, 3, []])
def test_sources_that_are_none_are_refused(labelled: Scene, source: object):
    entry = objects_document(labelled)["objects"][0] | {"label_source": source}
    with pytest.raises((TypeError, ValueError)):
        SceneObject.from_json(entry)


def test_a_source_without_a_label_is_refused(scene: Scene):
    entry = objects_document(scene)["objects"][0] | {"label_source": "user"}
    with pytest.raises(ValueError, match="there is no label, but its source 'user'"):
        SceneObject.from_json(entry)
