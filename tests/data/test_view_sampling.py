import numpy as np
import pytest

from instok3d.data.view_sampling import (
    eight_view_protocol,
    sample_many_views,
    sample_two_views,
    two_view_protocol,
)


@pytest.mark.parametrize("num_frames", [3, 4, 16])
def test_two_views_see_a_new_frame_and_then_themselves(num_frames):
    rng = np.random.default_rng(0)
    for _ in range(200):
        choice = sample_two_views(rng, num_frames, num_targets=3)
        low, high = sorted(choice.context)
        assert 1 <= high - low <= 4
        assert choice.target[0] not in choice.context
        assert low - 1 <= choice.target[0] <= high + 1
        assert 0 <= choice.target[0] < num_frames
        assert set(choice.target[1:]) == set(choice.context)


def test_two_views_are_mostly_two_apart_in_both_orders():
    rng = np.random.default_rng(0)
    gaps = np.array([np.diff(sample_two_views(rng, 16).context)[0] for _ in range(1000)])
    assert 0.6 < np.mean(np.abs(gaps) == 2) < 0.8
    assert 0.4 < np.mean(gaps > 0) < 0.6


def test_many_views_take_every_other_frame():
    rng = np.random.default_rng(0)
    for views in range(2, 9):
        choice = sample_many_views(rng, 16, num_views=views, num_targets=2)
        assert len(choice.context) == views
        assert set(np.abs(np.diff(choice.context))) == {2}
        assert len(set(choice.target)) == 2
        if views > 2:
            assert not set(choice.target) & set(choice.context)


def test_too_short_scenes_are_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="at least 3 frames"):
        sample_two_views(rng, 2)
    with pytest.raises(ValueError, match="3 to 14 frames"):
        sample_many_views(rng, 14, num_views=8)
    with pytest.raises(ValueError, match="15 frames"):
        eight_view_protocol(14)
    with pytest.raises(ValueError, match=r"1\.\.14"):
        two_view_protocol(16, center=15)


def test_protocols_by_hand():
    assert two_view_protocol(16, center=5).context == (4, 6)
    assert two_view_protocol(16, center=5).target == (5,)
    assert eight_view_protocol(16).context == (0, 2, 4, 6, 8, 10, 12, 14)
    assert eight_view_protocol(16).target == (1, 3, 5, 7, 9, 11, 13)
