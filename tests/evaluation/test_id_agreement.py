from dataclasses import replace

import pytest
import torch

from flat_rooms import oracle
from instok3d.evaluation.id_agreement import agreement, id_agreement
from instok3d.evaluation.prediction import predict
from instok3d.types import Cameras

INTRINSICS = torch.tensor([[2.0, 0, 2], [0, 2, 0.5], [0, 0, 1]])


def side_by_side(shift: float = 1.0) -> Cameras:
    """Two cameras of 1 x 4 pixels; at depth 2 the second sees all `shift` pixels further left."""
    poses = torch.eye(4).repeat(2, 1, 1)
    poses[1, 0, 3] = -shift  # f = 2 and z = 2: one unit is one pixel
    return Cameras(poses, INTRINSICS.repeat(2, 1, 1))


def test_agreement_by_hand():
    # Pixels 1, 2, 3 of the first view are pixels 0, 1, 2 of the second one. Ids 5, 6, 6 meet
    # 5, 6, 7: two of three agree, seen from either side.
    ids = torch.tensor([[[4, 5, 6, 6]], [[5, 6, 7, 8]]])
    assert agreement(ids, torch.full((2, 1, 4), 2.0), side_by_side()) == pytest.approx(2 / 3)


def test_a_pixel_of_no_group_agrees_with_none():
    ids = torch.tensor([[[4, -1, 6, 6]], [[-1, 6, 6, 8]]])
    assert agreement(ids, torch.full((2, 1, 4), 2.0), side_by_side()) == pytest.approx(2 / 3)


def test_only_pixels_of_the_same_surface_count():
    # Pixel 2 of the second view shows something nearer and pixel 1 something unknown.
    ids = torch.tensor([[[4, 5, 6, 7]], [[5, 0, 0, 0]]])
    depths = torch.full((2, 1, 4), 2.0)
    depths[1, 0, 1], depths[1, 0, 2] = 0, 1.5
    # From the first view pixel 1 alone counts and agrees; from the second one pixel 0 agrees, and
    # pixel 2 at depth 1.5 moves to x = 2.5 * 1.5 / 2 ... = 3.83, where the first view has 2.0.
    assert agreement(ids, depths, side_by_side()) == 1.0


@pytest.mark.parametrize("shift", [4.0, 0.0])
def test_views_that_share_nothing_have_no_agreement_and_equal_views_a_full_one(shift):
    ids = torch.arange(4).view(1, 1, 4).repeat(2, 1, 1)
    expected = None if shift else 1.0
    assert agreement(ids, torch.full((2, 1, 4), 2.0), side_by_side(shift)) == expected


def test_one_view_and_unknown_depth_have_no_agreement():
    cameras = side_by_side()
    assert agreement(torch.zeros(2, 1, 4).long(), torch.zeros(2, 1, 4), cameras) is None
    assert agreement(torch.zeros(1, 1, 4).long(), torch.ones(1, 1, 4), cameras.view(0)) is None


def test_a_model_that_knows_the_scene_agrees_with_itself(flat_sample):
    prediction = predict(oracle(flat_sample), flat_sample, "predicted", with_ids=True)
    assert prediction.rendered_ids is not None
    assert len(prediction.rendered_ids.ids) == 3
    share = id_agreement(flat_sample, prediction.rendered_ids)
    assert share is not None
    assert share > 0.95


def test_without_true_depth_the_rendered_depth_says_where_surfaces_are(flat_sample):
    model = oracle(flat_sample, unit=2.5)
    prediction = predict(model, flat_sample, "predicted", with_ids=True)
    assert prediction.rendered_ids is not None
    blind = replace(
        flat_sample,
        context=replace(flat_sample.context, depths=torch.zeros(1, 2, 32, 32)),
        target=replace(flat_sample.target, depths=torch.zeros(1, 1, 32, 32)),
    )
    share = id_agreement(blind, prediction.rendered_ids)
    assert share is not None
    assert 0.95 < share < 1


def test_ids_are_rendered_only_if_they_are_asked_for(flat_sample):
    assert predict(oracle(flat_sample), flat_sample, "predicted").rendered_ids is None
