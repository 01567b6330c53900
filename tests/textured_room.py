"""Photos of a box room with patterned walls, from known cameras."""

from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from depth_room import HALF_SIZES
from instok3d.geometry.cameras import intrinsics_from_field_of_view, invert_rigid, pixel_rays
from instok3d.geometry.registration import rigid_from_twist

HEIGHT, WIDTH = 240, 320
INTRINSICS = intrinsics_from_field_of_view(torch.tensor(1.15, dtype=torch.float64), HEIGHT, WIDTH)


def cameras(count: int = 8) -> Tensor:
    """cam_from_world of a walk to the side; each camera turns by 4 degrees and steps by 0.25."""
    twist = torch.zeros(count, 6, dtype=torch.float64)
    number = torch.arange(count) - 0.5 * (count - 1)
    twist[:, 0], twist[:, 2] = 0.25 * number, 0.02 * number.square()
    twist[:, 4], twist[:, 3] = -0.07 * number + 0.3, 0.02 * number
    return invert_rigid(rigid_from_twist(twist))


def photograph(cam_from_world: Tensor) -> np.ndarray:
    """One picture, with an octave of the pattern for every size from the wall to a pixel."""
    rng = np.random.default_rng(0)
    world_from_cam = invert_rigid(cam_from_world)
    rays = pixel_rays(INTRINSICS, HEIGHT, WIDTH) @ world_from_cam[:3, :3].T
    origin = world_from_cam[:3, 3]
    # A wall at +-size is met where origin + t ray = +-size, on the side that the ray looks to.
    meeting = (rays.sign() * HALF_SIZES - origin) / rays
    distance, axis = meeting.min(dim=-1)
    points = (origin + distance[..., None] * rays).numpy()
    wall = (2 * axis + (rays.gather(-1, axis[..., None])[..., 0] > 0)).numpy()
    others = np.array([[1, 2], [0, 2], [0, 1]])[axis.numpy()]
    places = np.take_along_axis(points, others, axis=-1) + 3
    picture = np.full((HEIGHT, WIDTH, 3), 0.5)
    for cell in (0.5, 0.25, 0.12, 0.06):
        values = rng.uniform(-0.25, 0.25, (6, 128, 128, 3))
        at, share = np.divmod(places / cell, 1)
        x, y = at.astype(int).transpose(2, 0, 1)
        right, down = share.transpose(2, 0, 1)[..., None]
        top = (1 - right) * values[wall, y, x] + right * values[wall, y, x + 1]
        bottom = (1 - right) * values[wall, y + 1, x] + right * values[wall, y + 1, x + 1]
        picture += (1 - down) * top + down * bottom
    return (255 * picture.clip(0, 1)).round().astype(np.uint8)


def save_photos(folder: Path, count: int = 8) -> list[Path]:
    """The pictures as files."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{number}.png" for number in range(count)]
    for path, camera in zip(paths, cameras(count), strict=True):
        Image.fromarray(photograph(camera)).save(path)
    return paths
