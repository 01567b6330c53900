import pytest
import torch

from instok3d.geometry.sampling import farthest_points


def test_farthest_points_on_a_line_by_hand():
    # From 0 the farthest of 0, 1, 4, 10 is 10; then 4 (distance 4 to 0) beats 1 (distance 1).
    points = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [4, 0, 0], [10, 0, 0]]])
    assert farthest_points(points, 3).tolist() == [[0, 3, 2]]


def test_asking_for_more_than_there_are_gives_each_point_once(rng):
    points = torch.randn(2, 6, 3, generator=rng)
    picked = farthest_points(points, 1000)
    assert picked.shape == (2, 6)
    assert all(sorted(row) == list(range(6)) for row in picked.tolist())


def test_copies_of_one_point_are_still_picked_once_each():
    points = torch.zeros(1, 5, 3)
    assert sorted(farthest_points(points, 5)[0].tolist()) == [0, 1, 2, 3, 4]


def test_points_that_are_not_finite_come_last():
    points = torch.tensor([[[torch.nan, 0, 0], [1, 0, 0], [torch.inf, 0, 0], [2, 0, 0]]])
    picked = farthest_points(points, 4)[0].tolist()
    assert picked[:2] == [1, 3]
    assert sorted(picked[2:]) == [0, 2]


def test_no_points_is_an_error():
    with pytest.raises(ValueError, match="points=0"):
        farthest_points(torch.zeros(1, 0, 3), 4)
