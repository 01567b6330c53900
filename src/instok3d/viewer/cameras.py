"""Cameras of a browser and of a scene, from one to the other."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid, rigid
from instok3d.geometry.moving import Point, Quaternion
from instok3d.geometry.rotations import matrix_to_quat, quat_to_matrix
from instok3d.scene.paths import around
from instok3d.scene.record import NEAR
from instok3d.scene.scene import Scene


@dataclass(frozen=True)
class Stand:
    """Where somebody stands and looks; the principal point is the middle of the picture."""

    center: Point
    quat_wxyz: Quaternion
    """Rotation world_from_cam, OpenCV axes."""
    vertical_fov_rad: float
    aspect: float
    """Width / height."""

    def look_at(self, distance: float) -> Point:
        """The point in the middle of the picture at a distance."""
        forward = quat_to_matrix(torch.tensor(self.quat_wxyz, dtype=torch.float64))[:, 2]
        x, y, z = (torch.tensor(self.center, dtype=torch.float64) + distance * forward).tolist()
        return x, y, z

    def up(self) -> Point:
        """The direction that points up in the picture."""
        x, y, z = (
            -quat_to_matrix(torch.tensor(self.quat_wxyz, dtype=torch.float64))[:, 1]
        ).tolist()
        return x, y, z

    def cam_from_world(self) -> Float[Tensor, "4 4"]:
        """The rigid transform into the camera's frame."""
        rotation = quat_to_matrix(torch.tensor(self.quat_wxyz, dtype=torch.float64))
        center = torch.tensor(self.center, dtype=torch.float64)
        return invert_rigid(rigid(rotation, center)).float()

    def intrinsics(self, height: int, width: int) -> Float[Tensor, "3 3"]:
        """For a picture of a size."""
        focal = 0.5 * height / math.tan(0.5 * self.vertical_fov_rad)
        return torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])


def stand_of_view(scene: Scene, view: int) -> Stand:
    """Where a photo was taken."""
    return _stand(scene.cameras.cam_from_world[view], scene.cameras.intrinsics[view], scene)


def first_stand(scene: Scene) -> Stand:
    """Where one stands at first: at the first photo, or where all is in the picture."""
    if scene.views:
        return stand_of_view(scene, 0)
    size = scene.height, scene.width
    cameras = around(scene.drawn_gaussians(), scene.vertical.up, *size, frames=1)
    return _stand(cameras.cam_from_world[0], cameras.intrinsics[0], scene)


def typical_distance(scene: Scene) -> float:
    """Of the scene from the first camera, scene units."""
    return scene.near_far[0] / NEAR


def _stand(
    cam_from_world: Float[Tensor, "4 4"], intrinsics: Float[Tensor, "3 3"], scene: Scene
) -> Stand:
    world_from_cam = invert_rigid(cam_from_world.detach().cpu().double())
    x, y, z = world_from_cam[:3, 3].tolist()
    w, i, j, k = matrix_to_quat(world_from_cam[:3, :3]).tolist()
    fov_rad = 2 * math.atan(0.5 * scene.height / float(intrinsics[1, 1]))
    return Stand((x, y, z), (w, i, j, k), fov_rad, scene.width / scene.height)
