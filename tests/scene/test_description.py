"""A scene in words and values: the red blob (1) to the left, the blue one (3) to the right."""

from dataclasses import replace

import pytest
import torch

from box_room import OFFICE, box_room, with_cameras
from instok3d.geometry.cameras import transform_points
from instok3d.scene.object_list import Scale
from instok3d.scene.run_lengths import RunLengths
from instok3d.scene.scene import Scene
from instok3d.scene.vertical import Vertical
from instok3d.scene.visibility import Sight


def test_an_office_in_words():
    room = box_room(OFFICE, each=600)
    room = with_cameras(room, [(2.0, -1.5, 1.8), (3.5, 0.2, 1.6), (1.5, 0.0, 2.2)], (1.6, 2.4, 0.6))
    assert str(room.describe()).splitlines() == [
        "A scene of 8 objects, seen in 3 photos, 3.96 x 3.11 x 2.63 m (length x width x height).",
        "- floor#1: brown; 3.93 x 2.95 x 0.16 m; at (1.97, 1.47); base at height 0.00",
        "- wall#2: white; 3.94 x 0.16 x 2.50 m; at (1.99, 3.03); base at height 0.13",
        "- desk#3: yellow; 1.60 x 0.86 x 0.81 m; at (0.89, 2.58); base at height 0.10; "
        "on floor#1; against wall#2; next to chair#5",
        "- cup#4: red; 0.16 x 0.16 x 0.18 m; at (0.44, 2.43); base at height 0.86; on desk#3",
        "- chair#5: blue; 0.56 x 0.56 x 0.90 m; at (1.04, 1.73); base at height 0.13; on floor#1",
        "- cabinet#6: green; 0.76 x 0.66 x 1.80 m; at (3.54, 2.68); base at height 0.13; "
        "on floor#1; against wall#2",
        "- box#7: red; 0.56 x 0.45 x 0.46 m; at (3.04, 0.78); base at height 0.10; on floor#1",
        "- stool#8: green; 0.46 x 0.46 x 0.56 m; at (0.59, 0.58); base at height 0.10; on floor#1",
    ]


def test_the_text_says_what_is_there(scene: Scene):
    named = scene.rename(1, "red ball")
    lines = str(named.describe()).splitlines()
    assert lines[0].startswith("A scene of 2 objects, seen in 2 photos, 1.")
    assert lines[1] == "The unit of lengths is unknown; their ratios are right."
    assert lines[2].startswith("Which way is up is uncertain (within 15 degrees with")
    assert lines[-3].startswith("Left out: ")
    assert lines[-3].endswith(" of the scene, which belongs to no object.")
    assert lines[-2].startswith("- red ball#1: red; ")
    assert lines[-1].startswith("- object#3: blue; ")
    assert "next to" not in lines[-1]  # the pair is said once


def test_lengths_and_places_are_those_of_the_upright_boxes(scene: Scene):
    upright = replace(scene, vertical=Vertical((0.0, -1.0, 0.0), "given", 1.0))
    found = upright.describe()
    assert "uncertain" not in str(found)
    lowest = max(item.aabb.max[1] for item in upright.objects)
    for each in found.objects:
        item = each.object
        assert each.size[2] == pytest.approx(item.aabb.max[1] - item.aabb.min[1], abs=1e-5)
        assert each.base == pytest.approx(lowest - item.aabb.max[1], abs=1e-5)
        assert each.size[0] >= each.size[1]
        # Up alone is fixed by the world: the height of the middle, and its way into the room.
        center = torch.tensor(item.aabb.min) + torch.tensor(item.aabb.max)
        moved = transform_points(found.room_from_world, center.double()[None] / 2)[0]
        assert float(moved[2]) == pytest.approx(each.middle[2], abs=1e-5)
        assert all(0 <= value <= size for value, size in zip(each.middle, (9, 9, found.size[2]),
                                                             strict=True))  # fmt: skip


def test_a_known_scale_gives_metres(scene: Scene):
    units, metres = scene.describe(), scene.describe(Scale(2.5, "known: object#1 is 1 m high"))
    assert (units.unit, metres.unit) == ("units", "m")
    assert metres.objects[0].size == pytest.approx([2.5 * value for value in units.objects[0].size])
    assert metres.objects[1].middle == pytest.approx([2.5 * v for v in units.objects[1].middle])
    assert metres.objects[1].base == pytest.approx(2.5 * units.objects[1].base)
    assert "unknown" not in str(metres)
    assert metres.to_json()["metres_per_scene_unit"] == 2.5
    assert torch.equal(metres.room_from_world, units.room_from_world)


def test_hidden_and_smaller_objects_are_counted(scene: Scene):
    found = scene.hide(3).describe()
    assert [each.object.id for each in found.objects] == [1]
    assert "Left out: 1 hidden object, " in str(found)
    largest = scene.move(3, scale=2).describe(most=1)
    assert [each.object.id for each in largest.objects] == [3]
    assert "Left out: 1 smaller object, " in str(largest)
    assert largest.relations == ()
    with pytest.raises(ValueError, match="most must be at least 1 object, got 0"):
        scene.describe(most=0)


def test_fragments_are_left_out_and_counted(scene: Scene):
    first, second = scene.objects
    mask = torch.zeros(scene.height, scene.width, dtype=torch.bool)
    mask[5, 5] = True
    piece = replace(second, confidence=0.3, sight=Sight((0,), None, (RunLengths.of(mask),)))
    found = replace(scene, objects=(first, piece)).describe()
    assert [each.object.id for each in found.objects] == [first.id]
    assert "Left out: 1 fragment" in str(found)
    assert found.to_json()["left_out"]["fragments"] == 1


def test_it_needs_neither_views_nor_semantics(scene: Scene):
    bare = replace(scene, semantics={})
    assert str(bare.describe()) == str(scene.describe())
    blind = replace(
        bare, views=(), photos=bare.photos[:0], cameras=bare.cameras.map(lambda each: each[:0])
    )
    found = blind.describe()
    assert [each.colors for each in found.objects] == [(), ()]
    assert str(found).startswith("A scene of 2 objects, 1.")


def test_the_empty_scene_is_described_too(empty_scene: Scene):
    found = empty_scene.describe()
    assert str(found).startswith("A scene of 0 objects, seen in 1 photo.\n")
    assert (found.objects, found.relations, found.size) == ((), (), (0, 0, 0))
    assert found.to_json()["objects"] == []
    assert str(found).endswith("Left out: 100% of the scene, which belongs to no object.")


def test_values_name_objects_by_key_and_say_how_true_relations_are(scene: Scene):
    near = scene.move(3, (-0.6, 0, 0))
    value = near.describe().to_json()
    assert value["text"] == str(near.describe())
    (said,) = value["relations"]
    assert (said["subject"], said["object"]) == ("object#1", "object#3")
    assert 0.5 <= said["fit"] <= 1
    assert [each["colors"] for each in value["objects"]] == [["red"], ["blue"]]
