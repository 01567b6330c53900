"""True cameras in the world of a predicted geometry, so that what was built there can be judged."""

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid
from instok3d.geometry.similarity import align_cameras, depth_scale
from instok3d.types import Cameras, Geometry, Views

SPREAD_MIN_M = 0.02
"""Context cameras closer together than this say nothing of the scale."""


@torch.no_grad()
def cameras_in_prediction(geometry: Geometry, context: Views, target: Views) -> Cameras:
    """The true target cameras as seen from the predicted world, with the true intrinsics.

    Scale: the ratio of true to predicted spread of the context cameras, or of depths where the
    cameras stand together. Rotation and translation: errors spread evenly over the contexts.

    Args:
        geometry: Predicted from the context views.
        context: Those views with true cameras and depths.
        target: Views with true cameras in the same world.
    """
    assert context.cam_from_world is not None
    assert context.depths is not None
    assert target.cam_from_world is not None
    assert target.intrinsics is not None
    cameras = []
    for scene in range(len(context.images)):
        predicted = geometry.cameras.cam_from_world[scene].float()
        true = context.cam_from_world[scene]
        true_spread, predicted_spread = _spread(true), _spread(predicted)
        if true_spread > SPREAD_MIN_M and predicted_spread > 1e-3:
            scale = true_spread / predicted_spread
        else:
            scale = depth_scale(geometry.depths[scene].float(), context.depths[scene])
        predicted_from_true = align_cameras(predicted, true, scale=scale)
        moved = target.cam_from_world[scene].clone()
        moved[:, :3, 3] = moved[:, :3, 3] / scale
        cameras.append(moved @ invert_rigid(predicted_from_true))
    return Cameras(torch.stack(cameras), target.intrinsics)


def _spread(cam_from_world: Float[Tensor, "view 4 4"]) -> Float[Tensor, ""]:
    centers = invert_rigid(cam_from_world)[:, :3, 3]
    return (centers - centers.mean(0)).norm(dim=-1).mean()
