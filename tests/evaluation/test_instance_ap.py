import numpy as np
import pytest
import torch
from PIL import Image

from instok3d.evaluation.instance_ap import (
    ApSettings,
    PredictedMasks,
    average_precision,
    match_image,
    predicted_masks,
    scene_macro_ap,
)

PLAIN = ApSettings(min_predicted_area=1)


def row(*runs: tuple[int, int]) -> np.ndarray:
    """An id map of one row: (id, length) after (id, length)."""
    return np.concatenate([np.full(length, value) for value, length in runs])[None]


def masks(ids: np.ndarray, *scores: float) -> PredictedMasks:
    return PredictedMasks(ids, np.array(scores, dtype=float))


def random_scene(seed: int, size: int = 24) -> tuple[np.ndarray, PredictedMasks]:
    """True ids in 4-pixel blocks (0 and -1 among them), and a prediction that is partly right."""
    rng = np.random.default_rng(seed)
    blocks = rng.integers(-1, 7, (size // 4, size // 4))
    true = np.kron(blocks, np.ones((4, 4), dtype=int))
    wrong = rng.integers(-1, 8, true.shape)
    ids = np.where(rng.random(true.shape) < 0.8, true - 1, wrong).clip(-1)
    return true, PredictedMasks(ids, rng.random(8).round(1))


def plain_ap(scenes: list[tuple[np.ndarray, PredictedMasks]], threshold: float, small: int):
    """The same rules, one mask and one pixel set at a time."""
    ranking, asked_in_all = [], 0
    for number, (true, predicted) in enumerate(scenes):
        asked = {i for i in np.unique(true) if i > 0 and (true == i).sum() >= small}
        asked_in_all += len(asked)
        for group, score in enumerate(predicted.scores):
            mask = predicted.ids == group
            if mask.sum() >= 2:
                ranking.append((-score, -mask.sum(), number, mask, true, asked))
    taken, hits = set(), []
    for _, _, number, mask, true, asked in sorted(ranking, key=lambda entry: entry[:2]):
        seen = mask & (true > 0)
        best, best_iou = None, threshold
        for instance in sorted(asked):
            target = true == instance
            iou = (seen & target).sum() / (seen | target).sum()
            if (number, instance) not in taken and (
                iou > best_iou or (best is None and iou >= best_iou)
            ):
                best, best_iou = instance, iou
        if best is not None:
            taken.add((number, best))
        elif 2 * (mask & ~np.isin(true, list(asked))).sum() >= mask.sum():
            continue
        hits.append(best is not None)
    precision = [sum(hits[: k + 1]) / (k + 1) for k in range(len(hits))]
    recall = [sum(hits[: k + 1]) / asked_in_all for k in range(len(hits))]
    points = []
    for wanted in np.linspace(0, 1, 101):
        points.append(
            max((p for p, r in zip(precision, recall, strict=True) if r >= wanted), default=0)
        )
    return np.mean(points)


def test_perfect_masks_have_ap_one():
    true = row((1, 12), (7, 30), (2, 25))
    result = average_precision(
        [match_image(true, masks(row((2, 12), (0, 30), (1, 25)), 0.9, 0.2, 0.4))]
    )
    assert (result.ap, result.ap50, result.ap25) == (1.0, 1.0, 1.0)
    assert (result.num_instances, result.num_masks) == (3, 3)


def test_ap_of_three_masks_by_hand():
    # Instances 1 and 2 of ten pixels. Ranking: group 0 covers 8 of instance 1 (IoU .8), group 1
    # covers 2 of it (IoU .2, a false positive everywhere), group 2 covers 6 of instance 2 (.6),
    # four of its pixels belong to no group.
    true = row((1, 10), (2, 10))
    predicted = masks(row((0, 8), (1, 2), (2, 6), (-1, 4)), 0.9, 0.8, 0.7)
    result = average_precision([match_image(true, predicted, PLAIN)])
    # At .25 and .5 to .6: precision 1, 1/2, 2/3 at recalls .5, .5, 1: 51 of the 101 points (0 to
    # .5) have precision 1, the other 50 have 2/3. At .65 to .8 only the first 51 points count;
    # above .8 nothing does.
    two_found = (51 + 50 * 2 / 3) / 101
    one_found = 51 / 101
    assert result.ap25 == pytest.approx(two_found)
    assert result.ap50 == pytest.approx(two_found)
    assert result.ap == pytest.approx((3 * two_found + 4 * one_found) / 10)


def test_the_names_and_order_of_ids_do_not_matter():
    for seed in range(3):
        true, predicted = random_scene(seed)
        rng = np.random.default_rng(seed)
        predicted = PredictedMasks(predicted.ids, rng.random(8))  # no two alike: no tie to break
        group_order = rng.permutation(8)  # old id of each new one
        renamed = PredictedMasks(
            np.where(predicted.ids < 0, -1, np.argsort(group_order)[predicted.ids]),
            predicted.scores[group_order],
        )
        other_ids = np.where(true > 0, rng.permutation(50)[np.maximum(true, 0)] + 1, true)
        before = average_precision([match_image(true, predicted)])
        after = average_precision([match_image(other_ids, renamed)])
        assert before == after


def test_one_instance_split_in_two_loses_ap50():
    true = row((1, 40), (2, 40))
    whole = average_precision([match_image(true, masks(row((0, 40), (1, 40)), 0.9, 0.8))])
    # Halves have IoU .5: at .50 the first half still matches, the second is a false positive
    # ranked above the right mask: precision 1, 1/2, 2/3.
    split = average_precision(
        [match_image(true, masks(row((0, 20), (1, 20), (2, 40)), 0.9, 0.8, 0.7))]
    )
    assert whole.ap50 == 1.0
    assert split.ap50 == pytest.approx((51 + 50 * 2 / 3) / 101)
    # Above .50 no half matches: one right mask, ranked third: precision 1/3 up to recall .5.
    assert split.ap == pytest.approx((split.ap50 + 9 * 51 / 101 / 3) / 10)


def test_no_prediction_is_zero_and_no_instance_is_nan():
    nothing = match_image(row((1, 30)), masks(row((-1, 30))))
    assert average_precision([nothing]).ap == 0.0
    background = match_image(row((0, 30)), masks(row((0, 30)), 0.5))
    assert np.isnan(average_precision([background]).ap)
    assert np.isnan(average_precision([]).ap)
    assert average_precision([nothing, background]).ap25 == 0.0


def test_a_mask_never_matches_an_instance_of_another_image():
    true = [row((1, 20), (0, 20)), row((0, 20), (1, 20))]
    swapped = [masks(row((-1, 20), (0, 20)), 0.9), masks(row((0, 20), (-1, 20)), 0.9)]
    settings = ApSettings(void="count")
    pairs = [match_image(t, p, settings) for t, p in zip(true, swapped, strict=True)]
    assert average_precision(pairs).ap25 == 0.0
    pairs = [match_image(t, p, settings) for t, p in zip(true, reversed(swapped), strict=True)]
    assert average_precision(pairs).ap == 1.0


def test_void_pixels_are_taken_out_or_counted():
    # Ten pixels of the instance and six beside it: IoU 10/10 without the void, 10/16 with it.
    true, predicted = row((1, 10), (0, 10)), masks(row((0, 16), (-1, 4)), 0.9)
    assert average_precision([match_image(true, predicted)]).ap == 1.0
    counted = average_precision([match_image(true, predicted, ApSettings(void="count"))])
    assert counted.ap == pytest.approx(3 / 10)  # right at .50, .55, .60


def test_a_mask_mostly_in_the_void_is_neither_right_nor_wrong():
    true = row((1, 20), (0, 30), (-1, 30))
    predicted = masks(row((0, 20), (1, 30), (2, 30)), 0.5, 0.9, 0.8)
    assert average_precision([match_image(true, predicted)]).ap == 1.0
    # Counted, the mask in the void is a false positive ranked first; id -1 is still left out.
    counted = average_precision([match_image(true, predicted, ApSettings(void="count"))])
    assert counted.ap == pytest.approx(0.5)


def test_a_small_instance_is_neither_demanded_nor_a_fault():
    true = row((1, 40), (2, 15))
    settings = ApSettings(min_instance_area=20)
    found = match_image(true, masks(row((0, 40), (1, 15)), 0.5, 0.9), settings)
    missed = match_image(true, masks(row((0, 40), (-1, 15)), 0.5), settings)
    for matches in (found, missed):
        assert matches.num_instances == 1
        assert average_precision([matches]).ap == 1.0


def test_predictions_below_the_area_are_dropped():
    true = row((1, 30), (2, 9))
    predicted = masks(row((0, 30), (1, 9)), 0.5, 0.9)
    assert match_image(true, predicted).scores.tolist() == [0.5]
    assert match_image(true, predicted, PLAIN).scores.tolist() == [0.9, 0.5]


@pytest.mark.parametrize("small", [0, 40])
def test_fast_matching_agrees_with_one_mask_at_a_time(small):
    scenes = [random_scene(seed) for seed in range(6)]
    settings = ApSettings(min_instance_area=small, min_predicted_area=2)
    matches = [match_image(true, predicted, settings) for true, predicted in scenes]
    result = average_precision(matches)
    assert 0.05 < result.ap50 < 0.95
    for value, threshold in ((result.ap50, 0.5), (result.ap25, 0.25)):
        assert value == pytest.approx(plain_ap(scenes, threshold, small))


def test_scene_macro_is_the_mean_of_scenes_with_instances():
    perfect = match_image(row((1, 30)), masks(row((0, 30)), 0.1))
    wrong = match_image(row((1, 30)), masks(row((-1, 30))))
    empty = match_image(row((0, 30)), masks(row((-1, 30))))
    assert scene_macro_ap([[perfect, perfect, perfect], [wrong], [empty]]).ap == 0.5
    assert average_precision([perfect, perfect, perfect, wrong]).ap == pytest.approx(76 / 101)
    assert np.isnan(scene_macro_ap([]).ap)


def test_ids_of_rendered_maps_by_hand():
    # Pixels: group 0, group 1, group 1, and one that nothing covers.
    maps = torch.tensor([[[0.7, 0.2, 0.1, 0.0]], [[0.1, 0.4, 0.8, 0.0]]])
    alphas = torch.tensor([[0.9, 0.6, 0.9, 0.0]])
    result = predicted_masks(maps, alphas)
    assert result.ids.tolist() == [[0, 1, 1, -1]]
    np.testing.assert_allclose(result.scores, [0.7, 0.6], rtol=1e-6)
    covered = predicted_masks(maps, alphas, alpha_min=0.6)
    assert covered.ids.tolist() == [[0, -1, 1, -1]]
    np.testing.assert_allclose(covered.scores, [0.7, 0.8], rtol=1e-6)
    none = predicted_masks(torch.zeros(0, 1, 4), alphas)
    assert none.ids.tolist() == [[-1] * 4]


def test_published_panels_rank_as_the_published_table(shared):
    # Masks cut from the figures of the project page; confidence = area. The paper's table ranks
    # ours first and IGGT+LUDVIG last; the two between lie within .03 of each other there too.
    folder = shared / "data" / "instok3d_authors" / "figure_panels"

    def load(row: int, method: str) -> np.ndarray:
        with Image.open(folder / f"instance_row{row}_{method}_ids.png") as image:
            return np.array(image).astype(np.int64)

    def evaluate(method: str) -> float:
        images = []
        for number in range(2):
            ids = load(number, method) - 1
            areas = np.bincount(ids[ids >= 0]).astype(float)
            settings = ApSettings(void="count")
            images.append(match_image(load(number, "gt"), PredictedMasks(ids, areas), settings))
        return average_precision(images).ap

    ours, objectgs, grouping, ludvig = map(
        evaluate, ["ours", "objectgs", "gaussian_grouping", "iggt_ludvig"]
    )
    assert ours > 0.5 > max(objectgs, grouping)
    assert min(objectgs, grouping) > 0.15 > ludvig


def test_the_thresholds_of_scannet_end_at_ninety_percent():
    true_ids = np.ones((10, 10), dtype=np.int64)
    ids = np.zeros((10, 10), dtype=np.int64)
    ids[0, :8] = -1  # 92 of 100 pixels: found at .50 to .90, not at .95
    found = average_precision([match_image(true_ids, PredictedMasks(ids, np.ones(1)))])
    assert found.ap == pytest.approx(0.9)
    assert found.ap_scannet == 1.0
