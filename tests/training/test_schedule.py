import math

import pytest

from instok3d.training.schedule import learning_rate, warmed_up


def rate(step: int) -> float:
    return learning_rate(step, peak=1.0, warmup_steps=10, cosine_steps=110, final_fraction=0.1)


def test_learning_rate_by_hand():
    # Warm-up in tenths; at step 10 the cosine begins at the peak; half way down (step 60) it is
    # 0.1 + 0.9 / 2; from step 110 on it stays at a tenth.
    assert rate(0) == pytest.approx(0.1)
    assert rate(9) == pytest.approx(1.0)
    assert rate(10) == pytest.approx(1.0)
    assert rate(60) == pytest.approx(0.55)
    assert rate(35) == pytest.approx(0.1 + 0.9 * 0.5 * (1 + math.cos(math.pi / 4)))
    assert rate(110) == rate(5000) == pytest.approx(0.1)


def test_learning_rate_without_warm_up_starts_at_the_peak():
    assert learning_rate(
        0, peak=2.0, warmup_steps=0, cosine_steps=10, final_fraction=0.0
    ) == pytest.approx(2.0)


def test_weight_rises_linearly_from_nothing():
    assert warmed_up(0, weight=0.1, warmup_steps=1500) == 0.0
    assert warmed_up(750, weight=0.1, warmup_steps=1500) == pytest.approx(0.05)
    assert warmed_up(9000, weight=0.1, warmup_steps=1500) == pytest.approx(0.1)
    assert warmed_up(0, weight=0.1, warmup_steps=0) == pytest.approx(0.1)
