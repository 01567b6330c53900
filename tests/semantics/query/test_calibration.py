"""Calibrations: fitted, written, refused where they cannot be."""

import math

import pytest
import torch

from instok3d.semantics.query.calibration import (
    Calibration,
    fit_logistic,
    fit_scale,
    naming_threshold,
    passing_threshold,
)


def test_a_probability_by_hand():
    # 2 x 0.5 + 4 x -0.25 + 0 = 0: one half; of a score of 0.75 and evidence 0: 1.5.
    found = Calibration(score_weight=2.0, evidence_weight=4.0, bias=0.0).probability(
        torch.tensor([0.5, 0.75]), torch.tensor([-0.25, 0.0])
    )
    assert found.tolist() == pytest.approx([0.5, 1 / (1 + math.exp(-1.5))])


def test_the_log_odds_of_counts_are_found():
    # Of value 0: 1 of 4 meant; of value 1: 3 of 4. Log-odds -ln 3 and + ln 3.
    values = torch.tensor([[0.0]] * 4 + [[1.0]] * 4)
    meant = torch.tensor([True, False, False, False, True, True, True, False])
    weights, bias = fit_logistic(values, meant, ridge=1e-9)
    assert bias == pytest.approx(-math.log(3), abs=1e-4)
    assert float(weights[0]) == pytest.approx(2 * math.log(3), abs=1e-4)


def test_separable_examples_have_bounded_weights():
    weights, bias = fit_logistic(torch.tensor([[0.0], [1.0]]), torch.tensor([False, True]))
    assert weights.isfinite().all()
    assert math.isfinite(bias)
    assert float(weights[0]) > 2


def test_a_scale_gives_the_truth_its_share():
    # Cosines differ by 0.5; the first is right in 3 of 4 cases: scale x 0.5 = ln 3.
    cosines = torch.tensor([[0.5, 0.0]] * 4)
    assert fit_scale(cosines, torch.tensor([0, 0, 0, 1])) == pytest.approx(
        2 * math.log(3), abs=1e-3
    )


def test_a_share_of_the_questions_passes():
    best = torch.tensor([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
    assert passing_threshold(best) == pytest.approx(0.2)
    assert passing_threshold(best, 1.0) == pytest.approx(0.1)
    with pytest.raises(ValueError, match="no question"):
        passing_threshold(torch.zeros(0))


def test_labels_are_given_where_they_are_more_often_right_than_not():
    # 100 objects, those below 0.4 always wrong, those above right.
    scores = torch.arange(100) / 100
    right = scores >= 0.395
    assert naming_threshold(scores, right) == pytest.approx(0.4)
    # A surprise at 0.7 pools with the sure ones below it, whose share stays above one half.
    right[70] = False
    assert naming_threshold(scores, right) == pytest.approx(0.4)
    # By hand: the right one at 0.2 and the wrong one at 0.3 pool to 1 / 2; the rest is right.
    few, known = torch.tensor([0.1, 0.2, 0.3, 0.4, 0.5]), torch.tensor([0, 1, 0, 1, 1]).bool()
    assert naming_threshold(few, known) == pytest.approx(0.2)
    assert naming_threshold(few, known, 0.6) == pytest.approx(0.4)
    assert naming_threshold(scores, torch.ones(100, dtype=torch.bool)) == 0
    assert naming_threshold(scores, torch.zeros(100, dtype=torch.bool)) == 1
    with pytest.raises(ValueError, match="no object"):
        naming_threshold(torch.zeros(0), torch.zeros(0, dtype=torch.bool))


def test_plain_values_keep_a_calibration():
    calibration = Calibration(threshold=0.25, bias=-3.0)
    assert Calibration.from_json(calibration.to_json()) == calibration


@pytest.mark.parametrize(
    "change",
    [{"threshold": 1.5}, {"bias": math.nan}, {"bias": "0"}, {"more": 1}, {"class_scale": 1e9},
     {"bias": None}, {"label_threshold": -0.1}],
)  # fmt: skip
def test_damaged_calibrations_are_refused(change: dict[str, object]):
    with pytest.raises((TypeError, ValueError)):
        Calibration.from_json(Calibration().to_json() | change)
    with pytest.raises(ValueError, match="a calibration has the numbers"):
        Calibration.from_json(None)
