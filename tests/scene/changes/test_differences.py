"""What changed in an office of boxes between two captures."""

from dataclasses import replace

import pytest
import torch

from box_room import MOTION, OFFICE, box_room, with_cameras
from instok3d.scene.changes.differences import find_differences
from instok3d.scene.changes.record import Difference
from instok3d.scene.scene import Scene
from made_scene import made_empty_scene

EYES = [(2.0, -1.5, 1.8), (3.5, 0.2, 1.6), (1.5, -0.5, 2.2)]


@pytest.fixture(scope="module")
def before() -> Scene:
    return box_room(OFFICE)


@pytest.fixture(scope="module")
def after() -> Scene:
    """Another capture, 0.4 times as large: chair moved, stool gone, a second box."""
    room = box_room(OFFICE, seed=1, motion=MOTION)
    x, y, z = (0.4 * MOTION.rotation() @ torch.tensor([-0.9, -0.7, 0]).double()).tolist()
    at = MOTION.points(torch.tensor([[2.0, 1.4, 0.0]]))[0].tolist()
    changed = room.move("chair", (x, y, z), yaw=20).remove("stool")
    return changed.insert(room, "box", at=at, scale=1.0)


@pytest.fixture(scope="module")
def found(before: Scene, after: Scene) -> Difference:
    return find_differences(before, after)


def keys(found: Difference, kind) -> list[str]:
    return [(each.before or each.after).key for each in found.of_kind(kind)]  # type: ignore[union-attr]


def test_moved_gone_and_new_are_told_and_nothing_else(found: Difference):
    assert keys(found, "moved") == ["chair#5"]
    assert keys(found, "gone") == ["stool#8"]
    assert keys(found, "new") == ["box#9"]
    assert len(found.of_kind("unchanged")) == 6
    assert found.of_kind("not seen") == ()


def test_the_way_of_what_moved_is_in_the_first_scenes_metres(found: Difference):
    (chair,) = found.of_kind("moved")
    assert found.unit == "m"  # of the first scene, since the second knows none
    assert chair.distance is not None
    assert found.length * chair.distance == pytest.approx((0.9**2 + 0.7**2) ** 0.5, abs=0.08)
    value = found.to_json()
    assert value["units"] == "metres"
    (moved,) = [each for each in value["changes"] if each["kind"] == "moved"]
    assert moved["distance"] == pytest.approx(1.14, abs=0.08)
    assert value["alignment"]["scale"] == pytest.approx(0.4, rel=0.03)
    assert "moved      chair#5 by 1.1" in str(found)
    assert str(found).endswith("1 moved, 1 gone, 1 new, 6 unchanged, 0 not seen")


def test_a_scene_does_not_differ_from_itself(before: Scene):
    same = find_differences(before, before)
    assert keys(same, "unchanged") == [item.key for item in before.objects]
    assert all(each.distance == pytest.approx(0, abs=1e-3) for each in same.changes)


def test_what_the_other_cameras_do_not_see_is_neither_gone_nor_new(before: Scene):
    # The cameras look at the cabinet's corner from near: stool and box are not in sight.
    later = box_room(OFFICE, seed=1).remove("stool").remove("box")
    blind = with_cameras(later, [(1.6, 1.2, 1.6)], (3.6, 2.7, 0.8))
    found = find_differences(before, blind)
    assert keys(found, "not seen") == ["box#7", "stool#8"]
    _, stool = found.of_kind("not seen")
    assert stool.note == "the second scene's cameras do not see its place"
    seeing = find_differences(before, with_cameras(later, EYES, (1.6, 1.8, 0.4)))
    assert set(keys(seeing, "gone")) == {"stool#8", "box#7"}
    back = find_differences(blind, before)
    assert keys(back, "not seen") == ["box#7", "stool#8"]
    assert back.of_kind("not seen")[0].note == "the first scene's cameras do not see its place"


def test_one_object_that_became_two_is_unchanged(before: Scene):
    merged = box_room(OFFICE, seed=1).merge("desk", "cabinet")
    found = find_differences(before, merged)
    assert set(keys(found, "unchanged")) == {item.key for item in before.objects}
    notes = {each.before.key: each.note for each in found.changes if each.before is not None}
    assert "a part of that object in the second scene" in (notes["desk#3"], notes["cabinet#6"])


def test_hidden_objects_are_not_there(before: Scene):
    found = find_differences(before, box_room(OFFICE, seed=1).hide("stool"))
    assert keys(found, "gone") == ["stool#8"]


def test_scenes_that_cannot_be_aligned_are_refused(before: Scene):
    for first, second in ((before, made_empty_scene()), (made_empty_scene(), before)):
        with pytest.raises(ValueError, match="share too few objects to be aligned: 0 pairs"):
            find_differences(first, second)
    alone = replace(before.only("chair"))
    with pytest.raises(ValueError, match="of 8 and 1 objects"):
        find_differences(before, alone)


def test_a_small_move_is_told_and_what_large_things_seem_to_move_is_not(before: Scene):
    room = box_room(OFFICE, seed=1)
    found = find_differences(before, room.move("box", (-0.3, 0, 0)).move("floor", (0.1, 0, 0)))
    assert keys(found, "moved") == ["box#7"]
    assert found.of_kind("moved")[0].distance == pytest.approx(0.3, abs=0.05)


def test_parts_of_the_building_do_not_change(before: Scene):
    # The same moves as of other things: the desk is told, until somebody names it a window.
    later = box_room(OFFICE, seed=1).move("desk", (-0.3, 0, 0)).remove("stool")
    found = find_differences(before, later)
    assert (keys(found, "moved"), keys(found, "gone")) == (["desk#3"], ["stool#8"])
    named = [
        replace(item, label={"desk": "window", "stool": "door"}.get(item.label, item.label))
        for item in before.objects
    ]
    found = find_differences(replace(before, objects=tuple(named)), later)
    assert (found.of_kind("moved"), found.of_kind("gone")) == ((), ())
    notes = {each.before.id: each.note for each in found.changes if each.before is not None}
    assert notes[3] == notes[8] == "a part of the building, which does not change"
    back = find_differences(later, replace(before, objects=tuple(named)))
    assert back.of_kind("new") == ()
