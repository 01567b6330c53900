import pytest
import torch

from instok3d.geometry.cameras import invert_rigid, transform_points
from instok3d.geometry.registration import rigid_from_twist
from instok3d.geometry.similarity import align_cameras, depth_scale, weighted_procrustes


def test_procrustes_recovers_a_rigid_motion_and_ignores_points_of_no_weight(rng):
    motion = rigid_from_twist(torch.randn(4, 6, generator=rng, dtype=torch.float64))
    source = torch.randn(4, 20, 3, generator=rng, dtype=torch.float64)
    target = transform_points(motion, source)
    target[:, :5] = 100.0
    weights = torch.ones(4, 20, dtype=torch.float64)
    weights[:, :5] = 0
    rotation, translation = weighted_procrustes(source, target, weights)
    torch.testing.assert_close(rotation, motion[:, :3, :3], atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(translation, motion[:, :3, 3], atol=1e-4, rtol=1e-4)


def test_mirrored_points_still_give_a_rotation(rng):
    source = torch.randn(1, 30, 3, generator=rng)
    rotation, _ = weighted_procrustes(source, -source, torch.ones(1, 30))
    assert float(torch.det(rotation)) == pytest.approx(1.0, abs=1e-4)


def test_depth_scale_is_the_median_ratio_over_known_pixels():
    # Ratios 2, 2, 10; the pixel of true depth 0 is unknown.
    predicted = torch.tensor([[1.0, 2.0, 1.0, 5.0]])
    true = torch.tensor([[2.0, 4.0, 10.0, 0.0]])
    assert float(depth_scale(predicted, true)) == 2.0


def test_depth_scale_without_known_depth_is_an_error():
    with pytest.raises(ValueError, match="true depth > 0"):
        depth_scale(torch.ones(1, 2, 2), torch.zeros(1, 2, 2))


def test_cameras_that_differ_by_a_similarity_align_exactly(rng):
    true = rigid_from_twist(torch.randn(3, 6, generator=rng, dtype=torch.float64))
    world_change = rigid_from_twist(torch.randn(6, generator=rng, dtype=torch.float64))
    # The predicted world is the true one moved and shrunk by 2.5.
    predicted = true @ invert_rigid(world_change)
    predicted[:, :3, 3] /= 2.5
    predicted_from_true = align_cameras(predicted, true, scale=2.5)
    shrunk = true.clone()
    shrunk[:, :3, 3] /= 2.5
    torch.testing.assert_close(shrunk @ invert_rigid(predicted_from_true), predicted)
