import pytest
import torch

from instok3d.scene.run_lengths import RunLengths


def test_runs_go_down_the_columns_and_begin_outside():
    mask = torch.tensor([[0, 1, 1], [0, 0, 1]], dtype=torch.bool)
    # Columns 00, 10, 11: two outside, one inside, one outside, two inside.
    found = RunLengths.of(mask)
    assert found == RunLengths(2, 3, (2, 1, 1, 2))
    assert (found.area, found.box()) == (3, (1, 0, 3, 2))
    assert RunLengths.of(~mask).counts == (0, 2, 1, 1, 2)


@pytest.mark.parametrize("share", [0.0, 0.03, 0.5, 1.0])
def test_a_mask_comes_back_from_json(share: float):
    mask = torch.rand(5, 7, generator=torch.Generator().manual_seed(0)) < share
    found = RunLengths.from_json(RunLengths.of(mask).to_json())
    assert torch.equal(found.mask(), mask)
    assert found.area == int(mask.sum())
    if not mask.any():
        assert found.box() == (0, 0, 0, 0)


@pytest.mark.parametrize(
    "value",
    [
        {"size": [2, 3], "counts": [5]},
        {"size": [2, 3], "counts": [7, -1]},
        {"size": [0, 3], "counts": []},
        {"size": [2, 3, 1], "counts": [6]},
        {"size": [2**20, 2**20], "counts": [2**40]},
        {"size": [2, 3], "counts": [6.0]},
        {"size": [2, 3]},
    ],
)
def test_what_is_no_mask_is_refused(value: object):
    with pytest.raises((ValueError, KeyError, TypeError)):
        RunLengths.from_json(value)


@pytest.mark.parametrize(
    ("row", "column", "expected"),
    [(1, 1, False), (0, 1, True), (2, 1, True), (1, 0, True), (1, 3, True)],
)
def test_a_mask_meets_the_frame_at_its_four_sides(row: int, column: int, expected: bool):
    mask = torch.zeros(3, 4, dtype=torch.bool)
    assert not RunLengths.of(mask).meets_frame()
    mask[row, column] = True
    assert RunLengths.of(mask).meets_frame() is expected
