import numpy as np
import pytest

from instok3d.evaluation.differences import RESAMPLES, Difference, differences
from instok3d.evaluation.figures import summarize
from instok3d.evaluation.instance_ap import IOU_THRESHOLDS, ImageMatches
from instok3d.evaluation.scores import SceneScore, ViewScore

LEVELS = np.random.default_rng(3).normal(25, 4, size=60)
"""Of the scenes, dB: far more than methods differ by."""


def scores(values, hits=None) -> list[SceneScore]:
    """A target view a scene; where hits are given also one mask, sure where it is right."""
    found = []
    for number, value in enumerate(values):
        matches = None
        if hits is not None:
            right = np.full((len(IOU_THRESHOLDS), 1), bool(hits[number]))
            score = np.array([0.9 if hits[number] else 0.1])
            none = np.zeros_like(right)
            matches = ImageMatches(score, np.array([100]), right, none, num_instances=1)
        views = (ViewScore(psnr=float(value), matches=matches),)
        found.append(SceneScore(str(number), "easy", views))
    return found


def test_what_all_scenes_agree_on_is_sure():
    found = differences(scores(LEVELS + 0.5), scores(LEVELS), ["psnr"])["psnr"]
    assert found.value == pytest.approx(0.5)
    assert found.standard_error == pytest.approx(0, abs=1e-9)


def test_the_error_is_that_of_a_mean_over_scenes():
    gains = np.random.default_rng(4).normal(0.2, 1.0, size=60)
    found = differences(scores(LEVELS + gains), scores(LEVELS), ["psnr"])["psnr"]
    assert found.value == pytest.approx(gains.mean())
    assert found.standard_error == pytest.approx(gains.std(ddof=1) / 60**0.5, rel=0.2)


def test_ap_is_pooled_over_the_scenes_that_are_drawn():
    half = [number % 2 == 0 for number in range(60)]
    ours, others = scores(LEVELS, [True] * 60), scores(LEVELS, half)
    found = differences(ours, others, ["ap50", "psnr"])
    assert found["ap50"].value == pytest.approx(0.5, abs=0.02)
    # Wrong masks come last, so that AP is the share of the scenes whose mask is right.
    assert found["ap50"].standard_error == pytest.approx(0.5 / 60**0.5, rel=0.25)
    assert found["psnr"] == Difference(0.0, 0.0)


def several_views(seed: int) -> list[SceneScore]:
    """Scenes of one to three target views with up to five masks each, some of them ignored."""
    random = np.random.default_rng(seed)
    found = []
    for number in range(12):
        views = []
        for _ in range(1 + number % 3):
            count = random.integers(6)
            right = random.random((len(IOU_THRESHOLDS), count)) < 0.4
            ignored = ~right & (random.random(right.shape) < 0.2)
            sureness, areas = random.random(count), random.integers(10, 14, size=count)
            matches = ImageMatches(sureness, areas, right, ignored, int(random.integers(6)))
            psnr = None if number == 4 else float(random.normal(25, 3))
            views.append(ViewScore(psnr=psnr, matches=None if number == 5 else matches))
        found.append(SceneScore(str(number), "easy", tuple(views)))
    return found


def test_figures_of_each_draw_are_those_of_its_scenes():
    ours, others = several_views(1), several_views(2)
    keys = ["ap50", "psnr", "ap", "ap25"]
    found = differences(ours, others, keys)
    draws = np.random.default_rng(0).integers(len(ours), size=(RESAMPLES, len(ours)))
    for key in keys:
        of_all = [getattr(summarize(scenes), key) for scenes in (ours, others)]
        assert found[key].value == pytest.approx(of_all[0] - of_all[1], abs=1e-12)
        drawn = [
            [getattr(summarize([scenes[n] for n in draw]), key) for scenes in (ours, others)]
            for draw in draws
        ]
        each = np.subtract(*np.array(drawn).T)
        assert found[key].standard_error == pytest.approx(each.std(ddof=1), abs=1e-12)


def test_scenes_without_instances_have_no_ap():
    assert list(differences(several_views(1)[5:6] * 2, several_views(2)[5:6] * 2, ["ap"])) == []
    nothing = scores(LEVELS, [True] * 60)[:0]
    assert differences(nothing, nothing, ["ap"]) == {}


def test_a_figure_that_cannot_be_drawn_is_refused():
    with pytest.raises(ValueError, match="no differences of fit_s"):
        differences(scores(LEVELS), scores(LEVELS), ["psnr", "fit_s"])


def test_what_one_of_the_two_has_not_is_left_out():
    found = differences(scores(LEVELS, [True] * 60), scores(LEVELS), ["ap", "psnr"])
    assert list(found) == ["psnr"]


def test_fewer_than_two_scenes_say_nothing():
    assert differences([], [], ["psnr"]) == {}
    assert differences(scores([20]), scores([21]), ["psnr"]) == {}


def test_other_scenes_are_refused():
    ours = scores([20, 21])
    for others in (ours[::-1], ours[:1]):
        with pytest.raises(ValueError, match="same scenes in the same order"):
            differences(ours, others, ["psnr"])
