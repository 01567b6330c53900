"""Exact depth of an empty box room, in metres, for any cameras in it."""

import torch
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid, pixel_rays
from instok3d.geometry.registration import rigid_from_twist

HALF_SIZES = torch.tensor([2.0, 1.3, 2.5], dtype=torch.float64)
INTRINSICS = torch.tensor([[40.0, 0, 24], [0, 40, 18], [0, 0, 1]], dtype=torch.float64)
HEIGHT, WIDTH = 36, 48


def walk(count: int, step: float = 0.15) -> Tensor:
    """world_from_cam of cameras that move to the side and turn towards a corner."""
    twist = torch.zeros(count, 6, dtype=torch.float64)
    twist[:, 0] = step * torch.arange(count)
    twist[:, 2] = 0.3 * step * torch.arange(count)
    twist[:, 4] = 0.35 + 0.04 * torch.arange(count)
    return rigid_from_twist(twist)


def room_depth(world_from_cam: Tensor) -> Tensor:
    """z-depth of the walls, view x HEIGHT x WIDTH."""
    rays = pixel_rays(INTRINSICS, HEIGHT, WIDTH) @ world_from_cam[:, None, :3, :3].mT
    origin = world_from_cam[:, None, None, :3, 3]
    # A wall at +-size is met where origin + t ray = +-size, on the side that the ray looks to.
    meeting = (rays.sign() * HALF_SIZES - origin) / rays
    return meeting.where(rays != 0, torch.inf).amin(dim=-1)


def room(count: int, step: float = 0.15) -> tuple[Tensor, Tensor]:
    """Depths and cam_from_world."""
    poses = walk(count, step)
    return room_depth(poses), invert_rigid(poses)
