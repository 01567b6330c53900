"""Gaussians carried along by a rigid motion."""

from dataclasses import replace

from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.cameras import transform_points
from instok3d.geometry.rotations import matrix_to_quat, quat_multiply
from instok3d.geometry.spherical_harmonics import rotate_sh
from instok3d.types import Gaussians


def move_gaussians(gaussians: Gaussians, to_from: Float[Tensor, "4 4"]) -> Gaussians:
    """The Gaussians in the frame that a rigid transform leads to, their colours turned along."""
    rotation = to_from[:3, :3]
    turn = matrix_to_quat(rotation).expand_as(gaussians.quats)
    return replace(
        gaussians,
        means=transform_points(to_from, gaussians.means),
        quats=quat_multiply(turn, gaussians.quats),
        sh=rotate_sh(gaussians.sh, rotation),
    )
