import pytest
import torch
from torch.nn import functional

from instok3d.geometry.cameras import rigid
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.types import Cameras, Gaussians


@pytest.fixture
def make_scene(rng):
    """Builds a random scene that fills the picture, and cameras that look at it."""

    def make(
        *, batch=None, views=2, count=60, anchors=7, degree=2, height=24, width=32,
        dtype=torch.float64,
    ):  # fmt: skip
        lead = (batch,) if batch is not None else ()

        def normal(*shape):
            return torch.randn(*lead, *shape, generator=rng, dtype=torch.float64)

        means = normal(count, 3) * torch.tensor([0.8, 0.6, 0.5]) + torch.tensor([0.0, 0.0, 3.0])
        gaussians = Gaussians(
            means=means.to(dtype),
            quats=functional.normalize(normal(count, 4), dim=-1).to(dtype),
            scales=(normal(count, 3) * 0.5 - 2.0).exp().to(dtype),
            opacities=(normal(count) * 1.5 - 0.5).sigmoid().to(dtype),
            sh=(normal(count, (degree + 1) ** 2, 3) * 0.3).to(dtype),
            anchor_index=torch.randint(anchors, (*lead, count), generator=rng),
        )
        turn = normal(views, 4) * 0.05 + torch.tensor([1.0, 0.0, 0.0, 0.0])
        intrinsics = torch.tensor(
            [[1.1 * width, 0, 0.48 * width], [0, 1.05 * width, 0.53 * height], [0, 0, 1]]
        )
        cameras = Cameras(
            cam_from_world=rigid(quat_to_matrix(turn), 0.1 * normal(views, 3)).to(dtype),
            intrinsics=intrinsics.to(dtype).expand(*lead, views, 3, 3).clone(),
        )
        return gaussians, cameras

    return make
