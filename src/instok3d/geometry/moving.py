"""Gaussians carried along by a rigid motion or a similarity."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.cameras import transform_points
from instok3d.geometry.rotations import matrix_to_quat, quat_multiply, quat_to_matrix
from instok3d.geometry.spherical_harmonics import rotate_sh
from instok3d.types import Gaussians

Point = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
NO_TURN: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Similarity:
    """x -> scale * rotation x + translation, in double precision."""

    translation: Point = (0.0, 0.0, 0.0)
    """Scene units."""
    quat_wxyz: Quaternion = NO_TURN
    """Rotation, unit length."""
    scale: float = 1.0
    """> 0, of lengths."""

    @staticmethod
    def about(
        pivot: Sequence[float],
        *,
        quat_wxyz: Sequence[float] = NO_TURN,
        scale: float = 1.0,
        by: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> "Similarity":
        """The turn and scaling that leave a point where it is, and then a translation `by`."""
        quat = torch.tensor(quat_wxyz, dtype=torch.float64)
        center = torch.tensor(pivot, dtype=torch.float64)
        moved = torch.tensor(by, dtype=torch.float64)
        if not (scale == 1 and tuple(quat_wxyz) == NO_TURN):
            quat = quat / quat.norm()
            moved = moved + center - scale * (quat_to_matrix(quat) @ center)
        x, y, z = moved.tolist()
        w, i, j, k = quat.tolist()
        return Similarity((x, y, z), (w, i, j, k), float(scale))

    def rotation(self) -> Float[Tensor, "3 3"]:
        """The rotation as a matrix in double precision."""
        return quat_to_matrix(torch.tensor(self.quat_wxyz, dtype=torch.float64))

    def points(self, points: Float[Tensor, "point 3"]) -> Float[Tensor, "point 3"]:
        """Points carried along, in their own precision."""
        moved = points.double()
        if self.quat_wxyz != NO_TURN or self.scale != 1:
            moved = self.scale * moved @ self.rotation().to(moved).mT
        return (moved + torch.tensor(self.translation).to(moved)).to(points.dtype)


def quat_about(axis: Sequence[float], angle_rad: float) -> Quaternion:
    """The rotation by an angle about an axis of unit length, right-handed."""
    x, y, z = (math.sin(angle_rad / 2) * value for value in axis)
    return math.cos(angle_rad / 2), x, y, z


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


def carry_gaussians(gaussians: Gaussians, motion: Similarity) -> Gaussians:
    """Unbatched Gaussians carried along by a similarity, their colours turned with them.

    What a pure translation leaves as it was stays so bit for bit.
    """
    moved = replace(
        gaussians,
        means=motion.points(gaussians.means),
        scales=(gaussians.scales.double() * motion.scale).to(gaussians.scales.dtype),
    )
    if motion.quat_wxyz == NO_TURN:
        return moved
    turn = torch.tensor(motion.quat_wxyz, dtype=torch.float64, device=gaussians.quats.device)
    quats = quat_multiply(turn.expand_as(gaussians.quats), gaussians.quats.double())
    sh = rotate_sh(gaussians.sh.double(), motion.rotation().to(gaussians.sh.device))
    return replace(
        moved,
        quats=torch.nn.functional.normalize(quats, dim=-1).to(gaussians.quats.dtype),
        sh=sh.to(gaussians.sh.dtype),
    )
