from dataclasses import replace

import pytest
import torch

from instok3d.pictures import display_color
from instok3d.scene.objects import SceneObject, counted, whole_first
from instok3d.scene.run_lengths import RunLengths
from instok3d.scene.scene import Scene
from instok3d.scene.visibility import Sight


def test_an_object_shows_itself_on_a_short_line(scene: Scene):
    for item in scene.objects:
        assert repr(item).startswith(f"<SceneObject {item.key} gaussians={item.num_gaussians} ")
        assert len(repr(item)) < 120
    named = replace(scene.objects[0], label="chair")
    assert repr(named).startswith("<SceneObject object#1 label='chair' ")


def test_a_record_survives_json(scene: Scene):
    for item in scene.objects:
        assert SceneObject.from_json(item.to_json((0.0, -1.0, 0.0))) == item


def test_neighbouring_ids_have_different_colors():
    colors = [display_color(index) for index in range(1, 41)]
    assert len(set(colors)) == 40
    assert all(len(color) == 7 and color[0] == "#" for color in colors)


def seen_as(item: SceneObject, confidence: float, *boxes: tuple[int, int, int, int]) -> SceneObject:
    """The object with rectangles as its masks, each in a view of 100 x 100."""
    masks = []
    for x0, y0, x1, y1 in boxes:
        mask = torch.zeros(100, 100, dtype=torch.bool)
        mask[y0:y1, x0:x1] = True
        masks.append(RunLengths.of(mask))
    sight = Sight(tuple(range(len(boxes))), None, tuple(masks))
    return replace(item, confidence=confidence, sight=sight)


INSIDE, AT_FRAME = (40, 40, 55, 60), (80, 0, 95, 20)
"""300 pixels each, 3 % of a view."""


@pytest.mark.parametrize(
    ("confidence", "boxes", "expected"),
    [
        (0.59, [INSIDE], True),
        (0.6, [INSIDE], False),
        (0.69, [AT_FRAME, AT_FRAME], True),
        (0.7, [AT_FRAME], False),
        (0.69, [AT_FRAME, INSIDE], False),
        (0.3, [INSIDE, (40, 40, 58, 60)], False),
        (0.3, [INSIDE, (40, 40, 57, 60)], True),
        (0.3, [], False),
    ],
    ids=["unsure", "sure", "cut off in each view", "cut off and sure", "whole in one view",
         "larger in one view", "no larger in any", "never seen"],
)  # fmt: skip
def test_a_fragment_is_small_in_each_view_and_unsure(
    scene: Scene, confidence: float, boxes: list[tuple[int, int, int, int]], expected: bool
):
    item = seen_as(scene.objects[0], confidence, *boxes)
    assert item.is_fragment is expected
    assert item.to_json((0.0, -1.0, 0.0))["fragment"] is expected


def test_fragments_come_last_and_are_counted(scene: Scene):
    pieces = [seen_as(item, 0.5, INSIDE) for item in scene.objects[:2]]
    assert whole_first([]) == []
    assert counted([]) == "0 objects"
    sure = seen_as(scene.objects[0], 0.9, INSIDE)
    assert whole_first([pieces[0], sure, pieces[1]]) == [sure, *pieces]
    assert counted([pieces[0], sure, pieces[1]]) == "3 objects (2 of them fragments)"
    assert counted([sure]) == "1 object"
