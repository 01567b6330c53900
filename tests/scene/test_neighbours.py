import pytest
import torch

from instok3d.scene.neighbours import Neighbour, find_neighbours
from instok3d.scene.scene import Scene


def test_neighbours_by_hand():
    # Object 5 borders 7 twice at depth 2, and 9 once behind a jump of depth, and the rest once.
    ids = torch.tensor([[[5, 5, 7, 7, 5, 5, 9, 9, 5, 5, 0, 0]]])
    depths = torch.tensor([[[2.0, 2, 2, 2, 2, 2, 3, 3, 2, 2, 2, 2]]])
    found = find_neighbours(ids, depths, [5, 7, 9])
    # Its border is 7, 7, 9, 9 and the rest: five pairs, all inside the picture.
    (touched,) = found[5]
    assert (touched.id, touched.share) == (7, pytest.approx(2 / 5))
    assert found[7] == (Neighbour(5, 1.0),)
    assert found[9] == ()


def test_the_largest_comes_first_and_a_touch_is_none():
    ids = torch.full((1, 4, 120), 1)
    ids[0, :, 60:] = 2
    ids[0, 2:, :100] = 3
    ids[0, 0, 110:] = 4
    found = find_neighbours(ids, torch.ones(1, 4, 120), [1, 2, 3, 4])
    assert [each.id for each in found[3]] == [1, 2]
    assert found[3][0].share > found[3][1].share > 0
    assert all(each.share >= 0.02 for one in found.values() for each in one)


def test_no_objects_and_no_views():
    assert find_neighbours(torch.zeros(1, 5, 5).long(), torch.ones(1, 5, 5), []) == {}
    none = find_neighbours(torch.zeros(0, 5, 5).long(), torch.zeros(0, 5, 5), [3])
    assert none == {3: ()}


def test_a_scene_names_the_neighbours_of_an_object(scene: Scene, empty_scene: Scene):
    # The red and the blue blob stand before the void, which is two units behind them.
    assert scene.neighbours() == {1: (), 3: ()}
    assert empty_scene.neighbours() == {}


def test_pieces_of_one_thing_are_neighbours_and_one_again_when_merged(scene: Scene):
    item = scene.object(1)
    low, high = item.aabb.min, item.aabb.max
    middle = (low[1] + high[1]) / 2
    halves = scene.split(1, box=((low[0] - 1, low[1] - 1, low[2] - 1), (high[0], middle, high[2])))
    new = halves.objects[-1].id
    assert [each.id for each in halves.neighbours()[1]] == [new]
    assert [each.id for each in halves.neighbours()[new]] == [1]
    assert halves.merge(1, new).neighbours()[1] == ()
