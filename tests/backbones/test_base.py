import pytest
import torch

from instok3d.backbones.base import GeometryBackbone, Prediction, settle_geometry
from instok3d.geometry.cameras import intrinsics_from_field_of_view, invert_rigid, rigid
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.types import Views


def some_cameras(rng: torch.Generator, *, batch: int = 1, views: int = 3) -> torch.Tensor:
    rotation = quat_to_matrix(torch.randn(batch, views, 4, generator=rng))
    return rigid(rotation, torch.randn(batch, views, 3, generator=rng))


def prediction(rng: torch.Generator, *, batch: int = 1, views: int = 3) -> Prediction:
    return Prediction(
        features=torch.rand(batch, views, 4, 2, generator=rng),
        depths=1 + torch.rand(batch, views, 4, 4, generator=rng),
        confidences=torch.ones(batch, views, 4, 4),
        cam_from_world=some_cameras(rng, batch=batch, views=views),
        intrinsics=intrinsics_from_field_of_view(torch.ones(batch, views), 4, 4),
    )


def photos(**given) -> Views:
    return Views(torch.zeros(1, 3, 3, 4, 4), **given)


def test_without_anything_given_the_prediction_stays(rng):
    predicted = prediction(rng)
    geometry = settle_geometry(photos(), predicted)
    torch.testing.assert_close(geometry.depths, predicted.depths)
    torch.testing.assert_close(geometry.cameras.cam_from_world[:, 0], torch.eye(4)[None])
    # In the first view the pointmap's z is the depth itself.
    torch.testing.assert_close(geometry.pointmaps[:, 0, ..., 2], predicted.depths[:, 0])


def test_given_depths_stand_and_bring_their_units(rng):
    # True depths are 3 times the predicted ones, known in the left half: the rest follows.
    predicted = prediction(rng)
    depths = 3 * predicted.depths
    depths[..., 2:] = 0
    geometry = settle_geometry(photos(depths=depths), predicted)
    torch.testing.assert_close(geometry.depths, 3 * predicted.depths)
    alone = settle_geometry(photos(), predicted)
    torch.testing.assert_close(geometry.pointmaps, 3 * alone.pointmaps, atol=1e-4, rtol=1e-4)


def test_given_cameras_stand_relative_to_the_first(rng):
    predicted, cameras = prediction(rng), some_cameras(rng)
    geometry = settle_geometry(photos(cam_from_world=cameras), predicted)
    expected = cameras @ invert_rigid(cameras[:, :1])
    torch.testing.assert_close(geometry.cameras.cam_from_world, expected)


def test_given_cameras_bring_their_units_to_predicted_depths(rng):
    predicted = prediction(rng)
    cameras = predicted.cam_from_world.clone()
    cameras[..., :3, 3] *= 0.5
    geometry = settle_geometry(photos(cam_from_world=cameras), predicted)
    torch.testing.assert_close(geometry.depths, 0.5 * predicted.depths)


def test_the_points_of_one_place_agree_between_views(rng):
    # All cameras at one spot see the same wall when depth and camera are given for it.
    predicted = prediction(rng)
    cameras = some_cameras(rng)[:, :1].repeat(1, 3, 1, 1)
    depths = predicted.depths[:, :1].repeat(1, 3, 1, 1)
    geometry = settle_geometry(photos(cam_from_world=cameras, depths=depths), predicted)
    torch.testing.assert_close(geometry.pointmaps[:, 2], geometry.pointmaps[:, 0])


def test_a_single_view_with_its_camera_keeps_predicted_depths(rng):
    predicted = prediction(rng, views=1)
    views = Views(torch.zeros(1, 1, 3, 4, 4), cam_from_world=some_cameras(rng, views=1))
    torch.testing.assert_close(settle_geometry(views, predicted).depths, predicted.depths)


def test_a_backbone_without_forward_cannot_be_made():
    with pytest.raises(TypeError, match="abstract"):
        GeometryBackbone()  # pyright: ignore[reportAbstractUsage]
