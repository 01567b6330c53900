import json

import numpy as np

from flat_rooms import SIZE
from instok3d.evaluation.instance_ap import ApSettings, PredictedMasks, match_image
from instok3d.evaluation.methods import Cost
from instok3d.evaluation.object_quality import ObjectScore
from instok3d.evaluation.score_files import score_from_json, score_to_json
from instok3d.evaluation.scores import GeometryScore, SceneScore, ViewScore


def matches(num_masks: int):
    """A picture of two instances, of which so many are predicted."""
    ids = np.zeros((SIZE, SIZE), dtype=np.int64)
    ids[:8], ids[8:16] = 1, 2
    predicted = np.full_like(ids, -1)
    for mask in range(num_masks):
        predicted[8 * mask : 8 * mask + 7] = mask
    masks = PredictedMasks(predicted, np.linspace(0.9, 0.1, num_masks) / 3)
    return match_image(ids, masks, ApSettings())


SCORE = SceneScore(
    name="7",
    level=None,
    views=(ViewScore(psnr=1 / 3, ssim=0.1, matches=matches(2), matches_large=matches(0)),
           ViewScore()),
    geometry=(GeometryScore(0.1, None, None, 1e-17, None),),
    groups_used=(3,),
    id_agreement=(None, 0.5),
    objects=(None, ObjectScore(1, 2, 3, 4, 5, 6, 7, 8, (0.25, 1.0), (3.0, 2.5))),
    instances_3d=(matches(1),),
    costs=(Cost(1, 2, 3, 0.1, 4),),
    picture_s=(0.3,),
)  # fmt: skip


def same(first: object, second: object) -> bool:
    """Equal in every value and every kind of number."""
    if isinstance(first, np.ndarray):
        return first.dtype == second.dtype and np.array_equal(first, second)  # type: ignore
    if hasattr(first, "__dataclass_fields__"):
        return type(first) is type(second) and all(
            same(getattr(first, name), getattr(second, name)) for name in vars(first)
        )
    if isinstance(first, tuple):
        return len(first) == len(second) and all(map(same, first, second))  # type: ignore
    return first == second


def test_a_score_comes_back_as_it_was():
    text = json.dumps(score_to_json(SCORE), allow_nan=False)
    assert same(score_from_json(json.loads(text)), SCORE)


def test_a_scene_of_which_nothing_was_measured_comes_back():
    empty = SceneScore("a", "easy", ())
    assert same(score_from_json(json.loads(json.dumps(score_to_json(empty)))), empty)
