"""What changed between two captures with cameras and marks."""

from dataclasses import replace

import pytest
import torch

from box_room import MOTION, OFFICE, Thing
from instok3d.scene.changes.differences import find_differences
from instok3d.scene.changes.eyes import Look, eyes_of
from instok3d.scene.changes.likeness import looks_alike, same_thing, way
from instok3d.scene.changes.marked_alignment import align_marks
from instok3d.scene.changes.record import Difference
from instok3d.scene.changes.sightings import Sighting
from instok3d.scene.changes.traits import traits_of
from instok3d.scene.scene import Scene
from marked_room import CHANNELS, capture, marked, office


@pytest.fixture(scope="module")
def before() -> Scene:
    return capture(office())


def keys(found: Difference, kind) -> list[str]:
    return [(each.before or each.after).key for each in found.of_kind(kind)]  # type: ignore[union-attr]


def test_a_scene_does_not_differ_from_itself(before: Scene):
    found = find_differences(before, before)
    assert found.alignment.matches > 100
    assert (found.of_kind("moved"), found.of_kind("gone"), found.of_kind("new")) == ((), (), ())
    assert f"aligned on {found.alignment.matches} places: " in str(found)
    assert found.to_json()["alignment"]["shared_places"] == found.alignment.matches


def test_moved_gone_and_new_are_told_and_nothing_else(before: Scene):
    things = {name: thing for name, thing in OFFICE.items() if name != "box"}
    old = capture(office(things))
    changed = office(OFFICE).move("chair", (1.2, -0.9, 0)).remove("stool")
    found = find_differences(old, capture(changed))
    assert keys(found, "moved") == ["chair#5"]
    assert found.of_kind("moved")[0].distance == pytest.approx(1.5, abs=0.05)
    assert keys(found, "gone") == ["stool#7"]
    assert keys(found, "new") == ["box#7"]
    back = find_differences(capture(changed), old)
    assert (keys(back, "moved"), keys(back, "gone"), keys(back, "new")) == (
        ["chair#5"], ["box#7"], ["stool#7"])  # fmt: skip


def test_what_the_other_cameras_do_not_see_is_neither_gone_nor_new(before: Scene):
    # The cameras look at the cabinet's corner from near: stool and box are not in sight.
    later = office().remove("stool").remove("box")
    found = find_differences(before, capture(later, [(1.6, 1.2, 1.6)], (3.6, 2.7, 0.8)))
    assert {"box#7", "stool#8"} <= set(keys(found, "not seen"))
    assert (found.of_kind("gone"), found.of_kind("new")) == ((), ())
    notes = {each.before.key: each.note for each in found.of_kind("not seen") if each.before}
    assert notes["stool#8"] == "the second scene's cameras do not see its place"


def test_parts_of_the_building_do_not_change(before: Scene):
    found = find_differences(before, capture(office().remove("stool")))
    assert keys(found, "gone") == ["stool#8"]
    for score, told in ((0.9, []), (0.5, ["stool#8"])):
        named = [replace(item, label="wall", label_source="semantics:made-1", label_score=score)
                 if item.label == "stool" else item for item in before.objects]  # fmt: skip
        found = find_differences(
            replace(before, objects=tuple(named)), capture(office().remove("stool"))
        )
        assert keys(found, "gone") == told


def test_hidden_objects_are_not_there(before: Scene):
    assert keys(find_differences(before, before.hide("stool")), "gone") == ["stool#8"]


def test_scenes_without_objects_have_no_changes(before: Scene):
    bare = replace(before, objects=())
    assert find_differences(bare, bare).changes == ()


def test_marks_lay_another_world_over_the_first():
    first, second = marked(office()), marked(office(motion=MOTION))
    found = align_marks(traits_of(first), traits_of(second))
    corners = torch.tensor([[x, y, z] for x in (0.0, 4) for y in (0.0, 3) for z in (0.0, 2.5)])
    apart = found.second_from_first.points(corners) - MOTION.points(corners)
    assert float(apart.norm(dim=1).max()) < 0.4 * 0.02  # two centimetres of a room of four metres
    assert found.second_from_first.scale == pytest.approx(0.4, rel=0.01)


def test_rooms_whose_marks_do_not_agree_are_refused(before: Scene):
    with pytest.raises(
        ValueError, match=r"no alignment of the two scenes can be trusted: .* 14 are"
    ):
        find_differences(before, capture(office(), seed=1))
    other = replace(before, provenance=replace(before.provenance, model="another"))
    assert find_differences(before, other).alignment.matches == 0  # by surfaces


def test_marks_of_a_hidden_object_are_left_out_and_owners_are_rows(before: Scene):
    whole, hidden = traits_of(before).marks, traits_of(before.hide("floor")).marks
    assert len(whole.positions) - len(hidden.positions) == 24  # of 1,200 Gaussians each fiftieth
    assert hidden.owners.unique().tolist() == list(range(7))
    assert whole.looks.shape[1] == CHANNELS
    torch.testing.assert_close(whole.looks.norm(dim=1), torch.ones(len(whole.looks)).double())


def test_the_way_of_a_thing_is_that_of_its_marks(before: Scene):
    traits = traits_of(before)
    moved = replace(traits, centers=traits.centers + 5)
    assert way(traits, moved, 4, 4).tolist() == pytest.approx([0, 0, 0])
    none = replace(traits.marks, looks=torch.zeros_like(traits.marks.looks))
    assert way(traits, replace(moved, marks=none), 4, 4).tolist() == pytest.approx([5, 5, 5])


def test_things_are_the_same_by_colour_and_marks(before: Scene):
    traits = traits_of(before)
    alike = looks_alike(traits, traits)
    torch.testing.assert_close(alike.diagonal(), torch.ones(8).double())
    same = same_thing(traits, traits, alike)
    # Of equal colour and marks, without embeddings: 4.4 * 0.85 + 4.05 - 6.95 = 0.84.
    torch.testing.assert_close(same.diagonal(), torch.full((8,), 0.84).double().sigmoid())
    assert float(same.fill_diagonal_(0).max()) < 0.35


def test_a_bias_of_depth_is_that_of_the_points_around():
    # Half of a picture is drawn a tenth too far, but for 16 points of a thing that is not there.
    y, x = (each.flatten() for each in torch.meshgrid(*2 * [torch.arange(64)], indexing="ij"))
    ratio = torch.full((64 * 64,), 0.1, dtype=torch.float64)
    thing = (x >= 30) & (x < 34) & (y >= 30) & (y < 34)
    ratio[thing] = 0.3
    inside = torch.ones_like(thing)
    bias = Look(0, x, y, torch.ones_like(ratio), inside, ratio).bias(64, 64)
    torch.testing.assert_close(bias[thing], torch.full((16,), 0.1).double(), atol=0.01, rtol=0)
    none = Look(0, x, y, torch.ones_like(ratio), ~inside, ratio).bias(64, 64)
    assert not none.any()


def test_points_are_looked_for_where_cameras_show_them(before: Scene):
    eyes = eyes_of(before)
    chair = traits_of(before)
    chair = chair.points[chair.of_object(4)]
    for look in eyes.looked_at(chair):
        assert look.inside.all()
        assert float(look.ratio.abs().median()) < 0.3  # half of a box hides the other half
        assert float(look.ratio.max()) < 0.1  # nothing shines through it
    assert not any(look.inside.any() for look in eyes.looked_at(chair - 50))


def test_a_place_that_looks_as_before_is_not_empty():
    there, empty = Sighting(1.0, 0.3, 0.9, 0.8, {}), Sighting(1.0, 3.0, 0.1, 0.1, {})
    # 1.05 * 0.3 - 1.7 * 0.9 - 3.8 * 0.8 + 1.6 = -2.655; 1.05 * 3 - 0.17 - 0.38 + 1.6 = 4.2.
    assert there.absent == pytest.approx(0.0657, abs=1e-4)
    assert empty.absent == pytest.approx(0.9852, abs=1e-4)


def test_a_thing_that_only_looks_alike_has_not_moved(before: Scene):
    # The box is gone, and something of its size but of another look and colour is elsewhere.
    other = Thing((2.2, 1.0, 0.0), (2.7, 1.4, 0.4), (0.9, 0.9, 0.1))
    things = {name: thing for name, thing in OFFICE.items() if name != "box"} | {"crate": other}
    found = find_differences(before, capture(office(things)))
    assert found.of_kind("moved") == ()
    assert keys(found, "gone") == ["box#7"]
    assert keys(found, "new") == ["crate#8"]
