import numpy as np
import pytest
import torch
from scipy import ndimage

from instok3d.scene.clean_up import _regions
from instok3d.scene.regions import connected_regions


def test_a_region_is_named_by_its_first_pixel():
    values = torch.tensor([[5, 5, 7], [7, 5, 7], [5, 7, 7]])
    # The 5 and the 7 of the lower left touch others of their kind by a corner alone.
    expected = torch.tensor([[0, 0, 2], [3, 0, 2], [6, 2, 2]])
    assert torch.equal(connected_regions(values), expected)


@pytest.mark.parametrize("shape", [(0, 4), (1, 1), (1, 5)])
def test_pictures_of_one_value_are_one_region(shape: tuple[int, int]):
    values = torch.ones(shape, dtype=torch.int64)
    assert torch.equal(connected_regions(values), values - 1)


def test_a_spiral_is_one_region():
    values = torch.zeros(9, 9, dtype=torch.int64)
    for row, column in ((1, slice(0, 8)), (3, slice(1, 9)), (5, slice(0, 8)), (7, slice(1, 9))):
        values[row, column] = 1
    assert connected_regions(values)[values == 0].unique().tolist() == [0]
    assert connected_regions(values)[values == 1].unique().tolist() == [9, 28, 45, 64]


def test_regions_of_groups_are_those_of_scipy(rng: torch.Generator):
    winners = torch.randint(0, 4, (21, 17), generator=rng) * 3
    found, owners, mains = _regions(winners, first=10)
    number = 10
    for group in winners.unique().tolist():
        of_group = np.zeros(winners.shape, dtype=np.int32)
        ndimage.label((winners == group).numpy(), output=of_group)
        sizes = np.bincount(of_group.ravel())[1:]
        for label, size in enumerate(sizes, start=1):
            assert (found[torch.from_numpy(of_group == label)] == number).all()
            assert owners[number - 10] == group
            assert mains[number - 10] == (size >= 0.5 * sizes.sum())
            number += 1
    assert len(owners) == len(mains) == number - 10
