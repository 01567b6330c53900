"""Test-time alignment of cameras to their photos, the scene frozen."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.registration import rigid_from_twist
from instok3d.render import render
from instok3d.types import Cameras, Gaussians


def refined_cameras(
    gaussians: Gaussians,
    cameras: Cameras,
    photos: Float[Tensor, "view 3 height width"],
    *,
    steps: int,
    learning_rate: float = 5e-3,
) -> Cameras:
    """Cameras moved until the renders look most like the photos: test-time pose alignment.

    Adam on a rigid motion for each view against the L1 difference, the scene frozen. This shows
    the evaluation the very photos that it is compared with, so figures made with it are marked.

    Args:
        gaussians: One scene.
        cameras: Where to start; no batch axis.
        photos: The true target photos.
        steps: Steps of Adam; 0 gives the cameras back.
        learning_rate: Of Adam, scene units and radians.
    """
    if steps == 0:
        return cameras
    twist = torch.zeros(len(photos), 6, device=photos.device, requires_grad=True)
    optimizer = torch.optim.Adam([twist], lr=learning_rate)
    height, width = photos.shape[-2:]
    with torch.enable_grad():
        for _ in range(steps):
            moved = rigid_from_twist(twist) @ cameras.cam_from_world
            image = render(gaussians, replace(cameras, cam_from_world=moved), height, width).colors
            loss = (image - photos).abs().mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    return replace(
        cameras, cam_from_world=rigid_from_twist(twist.detach()) @ cameras.cam_from_world
    )
