import numpy as np
import pytest
import torch

from instok3d.baselines.degraded_masks import DegradationSettings, degraded_masks

CLEAN = DegradationSettings(missed=0.0, joined=0.0, halved=0.0, border_px=0.0)


def quarters() -> torch.Tensor:
    """Two views of four squares, ids 5, 6, 8 and, in the last corner, none."""
    ids = torch.zeros(2, 32, 32, dtype=torch.int64)
    ids[:, :16, :16], ids[:, :16, 16:], ids[:, 16:, :16] = 5, 6, 8
    ids[:, 16:, 16:] = torch.tensor([0, -1])[:, None, None]
    return ids


def only(**faults: float) -> torch.Tensor:
    settings = DegradationSettings(**{**vars(CLEAN), **faults})
    return degraded_masks(quarters(), seed=(0,), settings=settings)


def test_without_faults_masks_are_the_true_ones_numbered_from_one():
    result = only()
    assert torch.equal(result > 0, quarters() > 0)
    for view in result:
        assert view.unique().tolist() == [0, 1, 2, 3]
        assert [int(view[0, 0]), int(view[0, 31]), int(view[31, 0])] == [1, 2, 3]


def test_missed_instances_have_no_mask():
    assert not only(missed=1.0).any()


def test_halved_instances_have_two_masks_that_make_up_the_whole():
    for view in only(halved=1.0):
        assert view.unique().tolist() == list(range(7))
        for rows, columns in ((slice(16), slice(16)), (slice(16), slice(16, 32))):
            names, areas = view[rows, columns].unique(return_counts=True)
            assert len(names) == 2
            assert areas.min() > 90  # of 256, through the middle


def test_joined_instances_have_one_mask():
    # 5 takes the name of a neighbour, the others are joined to what is left beside them.
    for view in only(joined=1.0):
        assert len(view[view > 0].unique()) < 3
        assert torch.equal(view > 0, quarters()[0] > 0)


def test_borders_are_displaced_by_about_the_deviation():
    moved = only(border_px=1.5)
    straight = only()
    changed = (moved != straight).float().mean()
    assert 0.02 < changed < 0.15
    assert torch.equal(moved[:, 4:10, 4:10], straight[:, 4:10, 4:10])
    assert not torch.equal(moved[0], moved[1])


def test_faults_come_from_the_seed():
    settings = DegradationSettings(halved=0.5)
    first, again, other = (
        degraded_masks(quarters(), seed=seed, settings=settings)
        for seed in ((1, 2), (1, 2), (1, 3))
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_no_view_and_no_instance_give_none():
    assert degraded_masks(torch.zeros(0, 8, 8, dtype=torch.int64), seed=(0,)).shape == (0, 8, 8)
    assert not degraded_masks(torch.zeros(1, 8, 8, dtype=torch.int64), seed=(0,)).any()
    full = degraded_masks(torch.full((1, 8, 8), 3), seed=(0,), settings=CLEAN)
    assert np.array_equal(full.numpy(), np.ones((1, 8, 8)))


def test_settings_out_of_range_are_refused():
    with pytest.raises(ValueError, match=r"halved must be in \[0, 1\], got 1.5"):
        DegradationSettings(halved=1.5)
    with pytest.raises(ValueError, match="border_px must be 0 or more, got -1"):
        DegradationSettings(border_px=-1.0)
