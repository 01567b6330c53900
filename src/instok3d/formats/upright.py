"""Scenes turned for formats whose axes are fixed."""

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.scene.vertical import Vertical

FLIP = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
"""From OpenCV axes (x right, y down, z forward) to those of OpenGL (y up, z backward), and back."""


def y_up(vertical: Vertical) -> Float[Tensor, "3 3"]:
    """A rotation of a scene's world after which its up is +y.

    A world of OpenCV axes is turned half around x. Any other up goes the shortest way to +y from
    there or from the world itself, whichever is nearer. An up that is not known well enough counts
    as OpenCV's.
    """
    if not vertical.is_stated:
        return FLIP.clone()
    first = FLIP if vertical.up[1] < 0 else torch.eye(3)
    up = torch.nn.functional.normalize(first @ torch.tensor(vertical.up), dim=0)
    # Rodrigues: about the axis up x y, by the angle between them; up . y >= 0.
    x, y, z = up.tolist()
    cross = torch.tensor([[0.0, -x, 0.0], [x, 0.0, z], [0.0, -z, 0.0]])
    return (torch.eye(3) + cross + cross @ cross / (1 + y)) @ first


def rigid_turn(rotation: Float[Tensor, "3 3"]) -> Float[Tensor, "4 4"]:
    """The transform that turns about the origin."""
    transform = torch.eye(4)
    transform[:3, :3] = rotation
    return transform
