import math

import pytest
import torch

from instok3d.evaluation.geometry_errors import camera_errors, depth_errors
from instok3d.geometry.cameras import rigid
from instok3d.geometry.rotations import quat_to_matrix


def turned(angle_deg: float, translation: tuple[float, float, float]) -> torch.Tensor:
    half = math.radians(angle_deg) / 2
    quat = torch.tensor([math.cos(half), 0.0, math.sin(half), 0.0])
    return rigid(quat_to_matrix(quat), torch.tensor(translation, dtype=torch.float32))


def test_errors_of_a_pair_by_hand():
    # Rotation about y of 12 instead of 10 degrees; baseline (1, 1, 0) of length sqrt(2) instead of
    # (1, 0, 0): 45 degrees off in direction, sqrt(2) - 1 in length. Read in the first camera, the
    # baseline of the second camera is -R^T t, so t = -R (baseline).
    def camera(angle_deg: float, center: tuple[float, float, float]) -> torch.Tensor:
        rotation = turned(angle_deg, (0, 0, 0))[:3, :3]
        return rigid(rotation, -rotation @ torch.tensor(center))

    true = torch.stack([torch.eye(4), camera(10, (1.0, 0, 0))])
    predicted = torch.stack([torch.eye(4), camera(12, (1.0, 1.0, 0))])
    errors = camera_errors(predicted, true)
    assert errors.rotation_deg.tolist() == pytest.approx([2.0], abs=1e-4)
    assert errors.direction_deg.tolist() == pytest.approx([45.0], abs=1e-4)
    assert errors.length_rel.tolist() == pytest.approx([math.sqrt(2) - 1], abs=1e-5)
    halved = camera_errors(predicted, true, scale=0.5)
    assert halved.length_rel.tolist() == pytest.approx([1 - math.sqrt(0.5)], abs=1e-5)


def test_cameras_in_another_world_and_scale_have_no_error(rng):
    quats, shifts = torch.randn(5, 4, generator=rng), torch.randn(5, 3, generator=rng)
    true = rigid(quat_to_matrix(quats), shifts).double()
    world = rigid(quat_to_matrix(torch.randn(4, generator=rng)), torch.randn(3, generator=rng))
    predicted = true @ world.double()
    predicted[:, :3, 3] /= 2.5
    errors = camera_errors(predicted, true, scale=2.5)
    assert errors.rotation_deg.shape == (10,)
    for values in (errors.rotation_deg, errors.direction_deg, errors.length_rel):
        assert float(values.max()) < 1e-4


def test_views_from_one_place_have_no_baseline_error():
    true = torch.stack([torch.eye(4), turned(30, (0, 0, 0))])
    errors = camera_errors(torch.stack([torch.eye(4), turned(30, (0.1, 0, 0))]), true)
    assert float(errors.rotation_deg[0]) == pytest.approx(0, abs=1e-4)
    assert errors.direction_deg.numel() == errors.length_rel.numel() == 0


def test_only_the_pairs_that_stand_apart_have_a_baseline_error():
    true = torch.stack([torch.eye(4), turned(30, (0, 0, 0)), turned(0, (1.0, 0, 0))])
    errors = camera_errors(true, true)
    assert errors.rotation_deg.shape == (3,)
    assert errors.direction_deg.shape == errors.length_rel.shape == (2,)


def test_a_predicted_camera_that_is_no_number_is_not_taken_for_an_unknown_baseline():
    true = torch.stack([torch.eye(4), turned(0, (1.0, 0, 0))])
    predicted = true.clone()
    predicted[1, 0, 3] = torch.nan
    assert camera_errors(predicted, true).direction_deg.isnan().all()


def test_one_view_has_no_pair():
    errors = camera_errors(torch.eye(4)[None], torch.eye(4)[None])
    assert errors.rotation_deg.numel() == errors.direction_deg.numel() == 0


def test_depth_errors_by_hand():
    # Ratios true / predicted are 2, 2, 4 and one pixel is unknown: s = 2. Scaled errors 0, 0, 1/2
    # give 1/6; unscaled |1-2|/2, |2-4|/4, |1-4|/4 = 1/2, 1/2, 3/4 give 7/12.
    predicted = torch.tensor([[[1.0, 2.0], [1.0, 9.0]]])
    true = torch.tensor([[[2.0, 4.0], [4.0, 0.0]]])
    errors = depth_errors(predicted, true)
    assert errors.scale == 2.0
    assert errors.scaled == pytest.approx(1 / 6)
    assert errors.unscaled == pytest.approx(7 / 12)


def test_all_views_of_a_scene_share_one_scale():
    # The second view is wrong by a factor of its own, which a scale for each view would hide.
    true = torch.full((2, 4, 4), 2.0)
    predicted = torch.stack([torch.full((4, 4), 1.0), torch.full((4, 4), 3.0)])
    assert depth_errors(predicted, true).scaled > 0.3
    with pytest.raises(ValueError, match="true depth > 0"):
        depth_errors(predicted, torch.zeros(2, 4, 4))
