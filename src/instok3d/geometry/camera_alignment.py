"""True target cameras in the world that a model made up from photos alone (method of Sec. 5).

Photos fix a scene up to a rotation, a shift and a length, and an uncalibrated camera up to its
focal length. To compare a render with a true photo, the true camera of that photo is brought into
the predicted world, and the cameras of the *context* views alone say how:

- the length is the ratio of the true to the predicted baselines of the context cameras, summed
  over all pairs; no true depth is used;
- the rotation is the mean over the context cameras, the shift brings the mean of their centres
  together (`similarity.align_cameras`);
- the focal length is the true one times the mean ratio of predicted to true focal lengths of the
  context views.

Where cameras were given to the model all this is the identity.
"""

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid, transform_points
from instok3d.geometry.similarity import align_cameras
from instok3d.types import Cameras

TargetCameras = Literal["aligned", "true"]
"""Where targets are rendered. true: at the true cameras as they are, so that the model must answer
in their unit and frame, as in the paper. aligned: at the true cameras, brought into the world that
the model predicts."""

BASELINE_MIN = 1e-3
"""Shorter baselines, in either world, count as this long: then they say nothing of the scale."""


def baseline_scale(
    predicted_cam_from_world: Float[Tensor, "view 4 4"],
    true_cam_from_world: Float[Tensor, "view 4 4"],
) -> float:
    """True length of one predicted unit: true over predicted baselines, summed over all pairs.

    The sum lets long baselines count for more, which are the well measured ones.
    """
    predicted, true = (
        torch.pdist(invert_rigid(cameras.double())[:, :3, 3]).sum().clamp_min(BASELINE_MIN)
        for cameras in (predicted_cam_from_world, true_cam_from_world)
    )
    return float(true / predicted)


def cameras_in_prediction(
    true_target: Cameras, *, predicted_context: Cameras, true_context: Cameras, scale: float
) -> Cameras:
    """The target cameras, expressed in the predicted world and with its focal lengths.

    Args:
        true_target: Target cameras in the true world; no batch axis.
        predicted_context: The context cameras that were predicted.
        true_context: The same cameras, true, in the world of the target cameras.
        scale: True length of one predicted unit.
    """
    predicted_from_true = align_cameras(
        predicted_context.cam_from_world.double(),
        true_context.cam_from_world.double(),
        scale=scale,
    )
    cam_from_true = true_target.cam_from_world.double()
    cam_from_true[:, :3, 3] /= scale
    intrinsics = true_target.intrinsics.clone()
    for axis in (0, 1):
        predicted = predicted_context.intrinsics[:, axis, axis]
        true = true_context.intrinsics[:, axis, axis]
        intrinsics[:, axis, axis] *= (predicted / true).mean()
    return Cameras(
        (cam_from_true @ invert_rigid(predicted_from_true)).to(intrinsics.dtype), intrinsics
    )


def points_in_prediction(
    points: Float[Tensor, "point 3"], *, predicted_context: Cameras, true_context: Cameras
) -> Float[Tensor, "point 3"]:
    """True points, expressed in the predicted world: what `cameras_in_prediction` does to cameras.

    Args:
        points: In the true world.
        predicted_context: The context cameras that were predicted.
        true_context: The same cameras, true.
    """
    predicted, true = predicted_context.cam_from_world, true_context.cam_from_world
    scale = baseline_scale(predicted, true)
    predicted_from_true = align_cameras(predicted.double(), true.double(), scale=scale)
    return transform_points(predicted_from_true, points.double() / scale).to(points.dtype)
