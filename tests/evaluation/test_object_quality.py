import pytest
import torch

from flat_rooms import oracle
from instok3d.data.sample import Sample
from instok3d.evaluation.methods import FAR, NEAR
from instok3d.evaluation.object_quality import (
    FoundObjects,
    ObjectScore,
    find_fragments,
    found_objects,
    score_objects,
)


def painted(
    ids: list[list[int]],
    objects: int,
    weights: torch.Tensor | None = None,
    fragments: tuple[int, ...] = (),
):
    """Objects that are fully opaque where they win, in views of one row."""
    numbers = torch.tensor(ids)[:, None]
    opaque = (numbers[:, None] == torch.arange(objects)[None, :, None, None]).float()
    pieces = torch.tensor([number in fragments for number in range(objects)], dtype=torch.bool)
    return FoundObjects(numbers, opaque if weights is None else weights, pieces)


def truth(ids: list[list[int]]) -> torch.Tensor:
    return torch.tensor(ids)[:, None]


def scored(true: list[list[int]], found: FoundObjects, area: int = 1) -> ObjectScore:
    score = score_objects(truth(true), found, min_instance_area=area)
    assert score is not None
    return score


def test_objects_and_instances_by_hand():
    # Instance 7 is object 0 but for one of its 4 pixels: IoU 3/4. Instance 9 falls into the
    # objects 1 (IoU 2/4) and 2 (1/4), which also has the missing pixel of 7.
    score = scored([[7, 7, 7, 7, 9, 9, 9, 9]], painted([[0, 0, 0, 2, 1, 1, 2, -1]], 3))
    assert (score.num_objects, score.num_instances) == (3, 2)
    assert (score.num_whole, score.num_found) == (2, 2)
    assert score.purities == pytest.approx((1.0, 1.0, 0.5))
    assert (score.num_fragments, score.num_whole_fragments) == (0, 0)


def test_fragments_are_counted_and_those_of_them_that_are_whole_after_all():
    found = painted([[0, 0, 0, 2, 1, 1, 2, -1]], 3, fragments=(1, 2))
    score = scored([[7, 7, 7, 7, 9, 9, 9, 9]], found)
    assert (score.num_whole, score.num_fragments, score.num_whole_fragments) == (2, 2, 1)


def test_a_thing_that_has_another_object_in_each_view_is_in_two_pieces():
    one = scored([[7] * 4, [7] * 4], painted([[0] * 4, [0] * 4], 1))
    two = scored([[7] * 4, [7] * 4], painted([[0, 0, 0, -1], [1, 1, 1, -1]], 2))
    assert (one.num_whole, one.num_found) == (1, 1)
    assert (two.num_objects, two.num_whole, two.num_found) == (2, 0, 0)


def test_purity_is_by_rendered_weight_and_not_by_pixels_won():
    # Object 0 wins all of instance 7 with weight .9, and shines through object 1 with .3.
    weights = torch.tensor([[[0.9, 0.9, 0.3, 0.3], [0.0, 0.0, 0.6, 0.6]]])[:, :, None]
    score = scored([[7, 7, 9, 9]], painted([[0, 0, 1, 1]], 2, weights))
    assert score.purities == pytest.approx((1.8 / 2.4, 1.0))
    assert score.weights == pytest.approx((2.4, 1.2))


def test_small_things_are_those_below_a_hundredth_of_every_view():
    # Of 200 pixels, 3 is 1 pixel in both views, 4 is 2 pixels in the second view.
    first, second = [3] + [1] * 199, [3] + [4] * 2 + [1] * 197
    score = scored([first, second], painted([[0] + [1] * 199, [0] + [1] * 199], 2))
    assert (score.num_instances, score.num_small, score.num_small_found) == (3, 1, 1)
    unseen = scored([first, second], painted([[0] + [1] * 199] * 2, 2), area=2)
    assert (unseen.num_instances, unseen.num_small) == (2, 0)


def test_what_is_unlabelled_counts_for_nothing():
    # The second view has no labels. Object 1 lies on unlabelled pixels by 2 of 3, object 2 has no
    # labelled pixel at all; the area of object 0 is its 2 labelled pixels.
    found = painted([[0, 0, 0, 1, 1, 1, 2], [3] * 7], 4)
    score = scored([[5, 5, 0, 6, 0, -1, 0], [-1] * 7], found)
    assert (score.num_objects, score.num_whole, score.num_instances) == (1, 1, 2)


def test_no_labels_have_no_score_and_no_objects_find_nothing():
    nothing = painted([[-1] * 4], 0)
    assert score_objects(truth([[0, -1, 0, 0]]), nothing, min_instance_area=1) is None
    score = scored([[7, 7, 7, 7]], nothing)
    assert (score.num_objects, score.num_found, score.purities) == (0, 0, ())


def test_the_truth_is_one_whole_object_for_each_instance(flat_sample: Sample):
    groups = oracle(flat_sample)(flat_sample.context)
    found = found_objects(
        groups.gaussians.scene(0), groups.assignment[0], groups.geometry.cameras.scene(0), 32, 32,
        near=NEAR, far=FAR,
    )  # fmt: skip
    score = score_objects(flat_sample.context_instances[0], found, min_instance_area=20)
    assert score is not None
    assert score.num_objects == score.num_instances == score.num_whole == score.num_found == 3
    assert min(score.purities) > 0.8  # the Gaussians blur over the edges by a third of a pixel
    assert (found.weights.sum(dim=1) <= 1 + 1e-5).all()


def test_a_scene_without_gaussians_has_no_objects(flat_sample: Sample):
    groups = oracle(flat_sample)(flat_sample.context)
    found = found_objects(
        groups.gaussians.scene(0).rows(slice(0, 0)), groups.assignment[0],
        groups.geometry.cameras.scene(0), 32, 32, near=NEAR, far=FAR,
    )  # fmt: skip
    assert found.weights.shape == (2, 0, 32, 32)
    assert (found.ids == -1).all()


def test_fragments_are_found_as_a_scene_finds_them():
    # In views of 40 x 40: 36 pixels of .65 at the rim of one view and 16 of .5, too few to be
    # seen, inside the other; 36 of .65 inside; 64 pixels, 4 %, of .1; and 25 pixels of .5.
    ids, scores = torch.full((2, 40, 40), -1), torch.zeros(2, 40, 40)
    for number, view, row, side, score in [
        (0, 0, 0, 6, 0.65), (0, 1, 20, 4, 0.5), (1, 0, 8, 6, 0.65), (2, 0, 20, 8, 0.1),
        (3, 1, 30, 5, 0.5),
    ]:  # fmt: skip
        ids[view, row : row + side, 10 : 10 + side] = number
        scores[view, row : row + side, 10 : 10 + side] = score
    assert find_fragments(ids, scores, 4).tolist() == [True, False, False, True]
    assert find_fragments(ids.clamp_max(-1), scores, 0).tolist() == []
