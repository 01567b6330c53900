import json

import numpy as np
import pytest

from instok3d.data.view_sampling import (
    RE10K_WARM_UP_STEPS,
    eight_view_protocol,
    frames_needed,
    lsm_protocol,
    mipnerf360_protocol,
    re10k_gaps,
    sample_frames,
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


@pytest.mark.parametrize(
    ("num_views", "spans"), [(2, {2, 4}), (4, {6, 12}), (8, {14, 28}), (16, {30, 60})]
)
def test_scannet_spans_are_those_of_uni3r(num_views, spans):
    rng = np.random.default_rng(0)
    seen = set()
    for _ in range(100):
        choice = sample_frames(rng, 70, num_views, 15, sampling="scannet")
        steps = set(np.diff(choice.context))
        assert len(steps) == 1
        seen.add(choice.context[-1] - choice.context[0])
        half = steps.pop() // 2
        middles = tuple(k + half for k in choice.context[:-1])
        assert choice.target == (middles if num_views > 2 else middles + choice.context)
        assert choice.context[0] >= 0
        assert choice.context[-1] < 70
    assert seen == spans


def test_scannet_uses_every_frame_of_the_shortest_scene():
    rng = np.random.default_rng(0)
    choice = sample_frames(rng, 15, 8, 7, sampling="scannet")
    assert choice == eight_view_protocol(15)
    assert sample_frames(rng, 3, 2, 1, sampling="scannet") == two_view_protocol(3)
    few = sample_frames(rng, 15, 8, 2, sampling="scannet").target
    assert len(set(few)) == 2
    assert set(few) < {1, 3, 5, 7, 9, 11, 13}


def test_re10k_gaps_grow_from_25_to_45_and_90():
    assert re10k_gaps(0) == (25, 25)
    # Half of the way: (25 + 45) / 2 = 35 and (25 + 90) / 2 = 57.5, which rounds to even.
    assert re10k_gaps(RE10K_WARM_UP_STEPS // 2) == (35, 58)
    assert re10k_gaps(RE10K_WARM_UP_STEPS) == re10k_gaps(10**9) == (45, 90)


@pytest.mark.parametrize(("num_frames", "highest"), [(46, 45), (60, 59), (300, 90)])
def test_re10k_targets_lie_between_contexts_of_the_wanted_gap(num_frames, highest):
    rng = np.random.default_rng(0)
    gaps = set()
    for _ in range(600):
        choice = sample_frames(rng, num_frames, 2, 7, sampling="re10k", step=10**6)
        first, last = choice.context
        gaps.add(last - first)
        assert 0 <= first < choice.target[0] < last < num_frames
        assert choice.target[1:] == choice.context
    assert (min(gaps), max(gaps)) == (45, highest)


def test_rooms_draw_what_their_own_functions_draw():
    for views, own in ((2, sample_two_views), (4, sample_many_views)):
        a, b = np.random.default_rng(7), np.random.default_rng(7)
        for _ in range(20):
            more = {} if views == 2 else {"num_views": views}
            assert sample_frames(a, 16, views, 2) == own(b, 16, num_targets=2, **more)


@pytest.mark.parametrize("sampling", ["rooms", "scannet", "re10k"])
@pytest.mark.parametrize("views", [2, 8])
def test_scenes_of_the_needed_length_suffice_and_shorter_ones_are_refused(sampling, views):
    if sampling == "re10k" and views > 2:
        with pytest.raises(ValueError, match="2 context views, got 8"):
            sample_frames(np.random.default_rng(0), 100, views, 1, sampling=sampling)
        return
    needed = frames_needed(views, sampling)
    assert sample_frames(np.random.default_rng(0), needed, views, 1, sampling=sampling).target
    with pytest.raises(ValueError, match=r"frames"):
        sample_frames(np.random.default_rng(0), needed - 1, views, 1, sampling=sampling)


def test_protocol_of_lsm_has_eight_samples_in_thirty_frames(shared):
    choices = lsm_protocol(30)
    protocol = json.loads((shared / "data/protocol/lsm_protocol.json").read_text())
    assert [choice.target[0] for choice in choices] == protocol["target_indices"]
    assert len(choices) * protocol["n_scenes"] == protocol["samples"]
    assert choices[0].context == (0, 2)
    assert lsm_protocol(2) == []
    assert [choice.target[0] for choice in lsm_protocol(5)] == [1]  # 4 lacks its next frame


def test_protocol_of_mipnerf360_by_hand():
    assert mipnerf360_protocol(4) == []
    choices = mipnerf360_protocol(13)  # 10 has 8 and 12
    assert [choice.target[0] for choice in choices] == [2, 6, 10]
    assert choices[1].context == (4, 8)
    assert len(mipnerf360_protocol(12)) == 2
