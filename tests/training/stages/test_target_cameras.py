"""Where the true target cameras come to lie in a world that was predicted."""

from dataclasses import replace

import pytest
import torch

from fake_rooms import FakeRooms
from instok3d.data.batches import make_sample
from instok3d.data.sample import collate
from instok3d.data.view_sampling import FrameChoice
from instok3d.geometry.cameras import invert_rigid
from instok3d.training.stages.target_cameras import target_cameras_in_prediction
from instok3d.types import Cameras, Geometry


@pytest.fixture(scope="module")
def sample():
    rooms = FakeRooms(2, size=16)
    return collate([make_sample(rooms, k, FrameChoice((4, 8), (6, 8))) for k in (0, 1)])


def predicted_in_units_of(length_m: float, sample) -> Geometry:
    """A perfect prediction, except that one of its units is length_m metres."""
    context = sample.context
    cam_from_world = context.cam_from_world.clone()
    cam_from_world[..., :3, 3] /= length_m
    batch, views, _, height, width = context.images.shape
    return Geometry(
        features=torch.zeros(batch, views, 1, 1),
        depths=context.depths / length_m,
        pointmaps=torch.zeros(batch, views, height, width, 3),
        confidences=torch.ones(batch, views, height, width),
        cameras=Cameras(cam_from_world, context.intrinsics),
    )


@pytest.mark.parametrize("scale_from", ["baselines", "depths"])
def test_perfect_prediction_in_other_units_gives_the_true_cameras_in_these(sample, scale_from):
    geometry = predicted_in_units_of(2.5, sample)
    cameras = target_cameras_in_prediction(geometry, sample.context, sample.target, scale_from)
    expected = sample.target.cam_from_world.clone()
    expected[..., :3, 3] /= 2.5
    torch.testing.assert_close(cameras.cam_from_world, expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(cameras.intrinsics, sample.target.intrinsics)


def test_cameras_that_stand_together_take_the_scale_of_the_depths(sample):
    """Contexts at one place: a camera 1 m to the right is 1 / 2.5 units away."""
    together = sample.context.cam_from_world[:, :1].expand(-1, 2, -1, -1).clone()
    context = replace(sample.context, cam_from_world=together)
    target = sample.target.cam_from_world.clone()
    target[:] = torch.eye(4)
    target[..., 0, 3] = -1.0
    cameras = target_cameras_in_prediction(
        predicted_in_units_of(2.5, replace(sample, context=context)),
        context,
        replace(sample.target, cam_from_world=target),
        "baselines",
    )
    centers = invert_rigid(cameras.cam_from_world)[..., :3, 3]
    torch.testing.assert_close(centers, torch.tensor([0.4, 0.0, 0.0]).expand(2, 2, 3))


def test_without_depth_targets_come_to_where_all_cameras_are_predicted(sample):
    """RealEstate10K has no depth; a young model may predict all cameras at one place."""
    geometry = predicted_in_units_of(2.5, sample)
    together = geometry.cameras.cam_from_world[:, :1].expand(-1, 2, -1, -1).clone()
    cameras = replace(geometry.cameras, cam_from_world=together)
    blind = replace(sample.context, depths=torch.zeros_like(sample.context.depths))
    found = target_cameras_in_prediction(
        replace(geometry, cameras=cameras), blind, sample.target, "baselines"
    )
    centers = invert_rigid(found.cam_from_world)[..., :3, 3]
    expected = invert_rigid(together)[:, :1, :3, 3].expand_as(centers)
    torch.testing.assert_close(centers, expected, atol=2e-3, rtol=0)
    with pytest.raises(ValueError, match="true depth"):
        target_cameras_in_prediction(geometry, blind, sample.target, "depths")
