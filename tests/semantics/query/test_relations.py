"""Places and sizes by boxes, each worked out by hand. z is up."""

import pytest
import torch

from instok3d.semantics.query.relations import (
    ORDER_KEYS,
    RELATIONS,
    UprightBoxes,
    between,
    gaps,
    relation,
)


def boxes(*pairs: tuple[tuple[float, float, float], tuple[float, float, float]]) -> UprightBoxes:
    ends = torch.tensor(pairs, dtype=torch.float32).reshape(-1, 2, 3)
    return UprightBoxes(ends[:, 0], ends[:, 1])


DESK = ((0.0, 0, 0), (1.6, 0.8, 0.75))
CUP = ((0.2, 0.2, 0.75), (0.3, 0.3, 0.85))
BOX = ((0.4, 0.2, 0), (0.7, 0.5, 0.3))
WALL = ((0.0, 0.8, 0), (4, 0.9, 2.5))
PICTURE = ((0.5, 0.78, 1.5), (1.0, 0.8, 1.9))
LAMP = ((0.3, 0.3, 2.2), (0.7, 0.7, 2.5))
ROOM = boxes(DESK, CUP, BOX, WALL, PICTURE, LAMP)
NAMES = ("desk", "cup", "box", "wall", "picture", "lamp")


def found(kind: str, first: str, second: str) -> float:
    return float(relation(kind, ROOM)[NAMES.index(first), NAMES.index(second)])


def test_gaps_by_hand():
    # Along x 3 apart, along y 4, along z they overlap: 5. The same box: 0.
    apart = gaps(boxes(((0, 0, 0), (1, 1, 1)), ((4, 5, 0), (5, 6, 1))))
    torch.testing.assert_close(apart, torch.tensor([[0.0, 5], [5, 0]]))


def test_next_to_falls_with_the_gap_relative_to_the_sizes():
    # Longest level sides 1 and 4: reach 2. Gap 0.5: 1 - 0.5 / 2. Of the third, gap 6.5: none.
    row = boxes(((0, 0, 0), (1, 1, 1)), ((1.5, 0, 0), (5.5, 1, 1)), ((12, 0, 0), (13, 1, 1)))
    near = relation("next to", row)
    assert float(near[0, 1]) == pytest.approx(0.75) == float(near[1, 0])
    assert float(near[1, 2]) == 0 == float(near[0, 2])
    # Against: reach 0.25 x 2 = 0.5, so that a gap of 0.5 is none.
    assert float(relation("against", row)[0, 1]) == 0
    touching = boxes(((0, 0, 0), (1, 1, 1)), ((1.1, 0, 0), (5.1, 1, 1)))
    assert float(relation("against", touching)[0, 1]) == pytest.approx(0.8)


def test_a_cup_stands_on_the_desk_and_not_the_desk_on_the_cup():
    assert found("on", "cup", "desk") == pytest.approx(1)
    assert found("on", "desk", "cup") == 0
    assert found("on", "box", "desk") == 0
    assert found("on", "lamp", "desk") == 0


def test_something_above_what_it_stands_on_by_half_its_margin_is_on_it_by_half():
    # Mean side 0.4, margin 0.1; 0.05 above.
    pair = boxes(((0, 0, 0), (2, 2, 1)), ((0.5, 0.5, 1.05), (0.9, 0.9, 1.45)))
    assert float(relation("on", pair)[1, 0]) == pytest.approx(0.5, abs=1e-5)


def test_a_pillow_on_the_seat_is_on_the_chair_whose_back_is_higher():
    # Base 0.25 below the top of a chair of 1: 1 - 0.25 / 0.5.
    pair = boxes(((0, 0, 0), (0.5, 0.5, 1)), ((0.1, 0.1, 0.75), (0.4, 0.4, 0.9)))
    assert float(relation("on", pair)[1, 0]) == pytest.approx(0.5, abs=1e-5)


def test_a_picture_hangs_on_the_wall_and_a_desk_only_stands_against_it():
    assert found("on", "picture", "wall") == pytest.approx(1)
    assert found("on", "desk", "wall") == 0
    assert found("against", "desk", "wall") == pytest.approx(1)
    assert found("against", "cup", "wall") == 0


def test_under_and_above_by_hand():
    # The box ends 0.45 below the desk's top, more than its half height 0.375.
    assert found("under", "box", "desk") == pytest.approx(1)
    assert found("under", "desk", "box") == 0
    assert found("above", "lamp", "desk") == pytest.approx(1)
    assert found("above", "desk", "lamp") == 0
    assert found("under", "desk", "lamp") == pytest.approx(1)


def test_in_is_the_share_within_by_hand():
    # Half of the small box lies in the large one.
    pair = boxes(((0, 0, 0), (2, 2, 2)), ((1.5, 0, 0), (2.5, 1, 1)))
    inside = relation("in", pair)
    assert float(inside[1, 0]) == pytest.approx(0.5)
    assert float(inside[0, 1]) == pytest.approx(0.5 * 0.5 * 0.5 / 2 * 2 / 2)


def test_nearest_and_farthest_put_objects_in_order():
    row = boxes(*(((x, 0, 0), (x + 1, 1, 1)) for x in (0.0, 3.0, 9.0)))
    assert relation("nearest", row)[:, 0].argsort(descending=True).tolist() == [1, 2, 0]
    assert relation("farthest", row)[:, 0].argsort(descending=True).tolist() == [2, 1, 0]


def test_between_is_on_the_line_of_the_middles():
    row = boxes(*(((x - 1, y - 1, 0), (x + 1, y + 1, 1)) for x, y in
                  ((0.0, 0), (10, 0), (5, 0), (5, 2.5), (20, 0))))  # fmt: skip
    place = between(row)[:, 0, 1]
    # 2.5 aside of a line of 10: 1 - 2 x 0.25.
    assert place.tolist() == pytest.approx([0, 0, 1, 0.5, 0])


def test_orders_by_hand():
    # Volumes 1, 8, 6; heights 1, 2, 6; longest level sides 1, 2, 1; middles 0.5, 1, 3.
    three = boxes(((0, 0, 0), (1, 1, 1)), ((0, 0, 0), (2, 2, 2)), ((0, 0, 0), (1, 1, 6)))
    first = {order: int(key(three).argmax()) for order, key in ORDER_KEYS.items()}
    assert first == {"largest": 1, "smallest": 0, "tallest": 2, "shortest": 0, "longest": 1,
                     "highest": 2, "lowest": 0}  # fmt: skip


@pytest.mark.parametrize("kind", RELATIONS)
def test_relations_are_numbers_in_0_to_1_without_units(kind: str, rng: torch.Generator):
    low = torch.rand(6, 3, generator=rng) * 4
    size = torch.rand(6, 3, generator=rng)
    size[0] = 0  # a point
    place = relation(kind, UprightBoxes(low, low + size))
    assert ((place >= 0) & (place <= 1)).all()
    assert (place.diagonal() == 0).all()
    if kind not in ("nearest", "farthest"):
        large = relation(kind, UprightBoxes(1000 * low, 1000 * (low + size)))
        torch.testing.assert_close(large, place, atol=1e-4, rtol=0)
    assert relation(kind, boxes()).shape == (0, 0)


def test_no_objects_are_between_nothing():
    assert between(boxes()).shape == (0, 0, 0)
