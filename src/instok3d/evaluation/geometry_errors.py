"""Errors of predicted cameras and depth against the true ones."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid
from instok3d.geometry.rotations import angle_between_rad
from instok3d.geometry.similarity import depth_scale

BASELINE_MIN = 1e-3
"""Baselines below this have no direction to compare."""


@dataclass(frozen=True)
class CameraErrors:
    """Errors of the relative camera between each pair of views."""

    rotation_deg: Float[Tensor, " pair"]
    """Angle between the predicted and the true relative rotation."""
    direction_deg: Float[Tensor, " apart"]
    """Angle between the predicted and the true baseline, in the first camera of the pair; of the
    pairs alone whose true cameras stand apart."""
    length_rel: Float[Tensor, " apart"]
    """|s |t_predicted| - |t_true|| / |t_true| with the scale that was given; of the same pairs."""


@dataclass(frozen=True)
class DepthErrors:
    """Mean relative depth errors |d_predicted - d| / d over all known pixels of a scene."""

    scaled: float
    """After one factor for the whole scene, the median of true over predicted depth."""
    unscaled: float
    """In the units that were predicted."""
    scale: float
    """True length of one predicted unit."""


def camera_errors(
    predicted_cam_from_world: Float[Tensor, "view 4 4"],
    true_cam_from_world: Float[Tensor, "view 4 4"],
    *,
    scale: float = 1.0,
) -> CameraErrors:
    """Errors of every pair of views; the two worlds may differ by any rigid motion.

    Args:
        predicted_cam_from_world: Cameras that were predicted.
        true_cam_from_world: The same cameras, true.
        scale: True length of one predicted unit.
    """
    first, second = torch.triu_indices(len(predicted_cam_from_world), len(true_cam_from_world), 1)
    predicted = _second_in_first(predicted_cam_from_world.double(), first, second)
    true = _second_in_first(true_cam_from_world.double(), first, second)
    rotation = angle_between_rad(predicted[:, :3, :3], true[:, :3, :3])
    baseline, true_baseline = scale * predicted[:, :3, 3], true[:, :3, 3]
    length, true_length = baseline.norm(dim=-1), true_baseline.norm(dim=-1)
    sine = torch.linalg.cross(baseline, true_baseline).norm(dim=-1)
    direction = torch.atan2(sine, (baseline * true_baseline).sum(-1))
    apart = true_length > BASELINE_MIN
    return CameraErrors(
        rotation_deg=rotation.rad2deg(),
        direction_deg=direction.rad2deg()[apart],
        length_rel=((length - true_length).abs() / true_length)[apart],
    )


def depth_errors(
    predicted: Float[Tensor, "view height width"], true: Float[Tensor, "view height width"]
) -> DepthErrors:
    """Relative errors over the pixels of all views whose true depth is known (> 0).

    Raises:
        ValueError: No pixel has a known true depth.
    """
    scale = depth_scale(predicted, true)
    known = true > 0
    predicted, true = predicted[known].double(), true[known].double()
    return DepthErrors(
        scaled=float(((predicted * scale - true).abs() / true).mean()),
        unscaled=float(((predicted - true).abs() / true).mean()),
        scale=float(scale),
    )


def _second_in_first(
    cam_from_world: Float[Tensor, "view 4 4"], first: Tensor, second: Tensor
) -> Float[Tensor, "pair 4 4"]:
    return cam_from_world[first] @ invert_rigid(cam_from_world[second])
