"""Which places are said, by boxes made by hand. z is up, lengths in metres."""

import pytest
import torch

from instok3d.scene.said_relations import said_relations
from instok3d.semantics.query.relations import UprightBoxes

Box = tuple[tuple[float, float, float], tuple[float, float, float]]
FLOOR: Box = ((0, 0, -0.05), (4, 3, 0))
WALL: Box = ((0, 3, 0), (4, 3.1, 2.5))
DESK: Box = ((0, 2.2, 0), (1.6, 3, 0.75))
CUP: Box = ((0.2, 2.4, 0.75), (0.3, 2.5, 0.85))
BOX: Box = ((0.4, 2.4, 0), (0.7, 2.7, 0.3))
CHAIR: Box = ((0.6, 1.5, 0), (1.1, 2.0, 0.9))
PICTURE: Box = ((2.5, 2.96, 1.5), (3.0, 3, 1.9))


def said(boxes: dict[str, Box], walls: tuple[str, ...] = ()) -> set[tuple[str, str, str]]:
    names = list(boxes)
    ends = torch.tensor(list(boxes.values()), dtype=torch.float32).reshape(-1, 2, 3)
    mask = torch.tensor([name in walls for name in names], dtype=torch.bool)
    found = said_relations(UprightBoxes(ends[:, 0], ends[:, 1]), mask)
    assert all(0.5 <= each.fit <= 1 for each in found)
    assert [each.subject for each in found] == sorted(each.subject for each in found)
    return {(names[each.subject], each.kind, names[each.other]) for each in found}


def test_an_office_by_hand():
    room = {"floor": FLOOR, "wall": WALL, "desk": DESK, "cup": CUP, "box": BOX, "chair": CHAIR,
            "picture": PICTURE}  # fmt: skip
    assert said(room, walls=("wall",)) == {
        ("desk", "on", "floor"), ("cup", "on", "desk"), ("box", "on", "floor"),
        ("chair", "on", "floor"), ("picture", "on", "wall"),
        ("desk", "against", "wall"), ("box", "under", "desk"), ("desk", "next to", "chair"),
    }  # fmt: skip


def test_without_floor_and_labels_places_follow_from_the_things_themselves():
    assert said({"desk": DESK, "box": BOX, "wall": WALL}) == {
        ("box", "under", "desk"), ("desk", "against", "wall"),
    }  # fmt: skip
    shelf: Box = ((0, 0, 0), (1, 0.4, 2))
    book: Box = ((0.3, 0.1, 0.5), (0.4, 0.3, 0.7))
    assert said({"shelf": shelf, "book": book}) == {("book", "in", "shelf")}
    out: Box = ((0.3, -0.1, 0.5), (0.4, 0.2, 0.7))  # a third of it looks out; it stands on a board
    assert said({"shelf": shelf, "book": out}) == {("shelf", "next to", "book")}
    top: Box = ((0.0, 2.2, 0.7), (1.6, 3.0, 0.75))
    lamp: Box = ((0.5, 2.4, 2.0), (0.9, 2.8, 2.3))
    assert said({"lamp": lamp, "table top": top}) == {("lamp", "above", "table top")}


def test_all_walls_as_one_thing_are_no_place():
    walls: Box = ((-0.1, -0.1, 0), (4.1, 3.1, 2.5))
    things = {"walls": walls, "desk": DESK, "cup": CUP, "chair": CHAIR}
    assert said(things) == {("cup", "on", "desk"), ("desk", "next to", "chair")}
    tilted: Box = ((-0.1, -0.1, -0.4), (4.1, 3.1, 0.1))
    assert ("desk", "on", "floor") in said(
        {"floor": tilted, "desk": DESK, "cup": CUP, "chair": CHAIR}
    )


def test_things_are_next_to_the_two_nearest_and_each_pair_is_said_once():
    row = {f"{number}": ((1.2 * number, 0.0, 0.0), (1.2 * number + 1, 1.0, 1.0))
           for number in range(4)}  # fmt: skip
    assert said(row) == {("0", "next to", "1"), ("1", "next to", "2"), ("2", "next to", "3")}
    cross: dict[str, Box] = {
        "middle": ((0.0, 0, 0), (1.0, 1, 1)), "west": ((-1.1, 0, 0), (-0.1, 1, 1)),
        "east": ((1.2, 0, 0), (2.2, 1, 1)), "north": ((0.0, 1.3, 0), (1.0, 2.3, 1)),
    }  # fmt: skip
    assert {other for subject, _, other in said(cross) if subject == "middle"} == {"west", "east"}


@pytest.mark.parametrize("count", [0, 1])
def test_nothing_is_said_of_less_than_two_things(count: int):
    assert said(dict([("desk", DESK)][:count])) == set()
