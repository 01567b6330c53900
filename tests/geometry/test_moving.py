import torch

from instok3d.geometry.cameras import invert_rigid, rigid
from instok3d.geometry.moving import move_gaussians
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.render import render
from instok3d.types import Cameras, Gaussians


def test_gaussians_and_camera_moved_alike_give_the_same_picture(rng):
    count = 30
    gaussians = Gaussians(
        means=torch.randn(count, 3, generator=rng) * 0.4 + torch.tensor([0.0, 0, 3]),
        quats=torch.randn(count, 4, generator=rng),
        scales=0.05 + 0.2 * torch.rand(count, 3, generator=rng),
        opacities=torch.rand(count, generator=rng),
        sh=torch.randn(count, 4, 3, generator=rng),
        anchor_index=torch.arange(count),
    )
    to_from = rigid(quat_to_matrix(torch.randn(4, generator=rng)), torch.tensor([1.0, -2, 0.5]))
    intrinsics = torch.tensor([[[30.0, 0, 16], [0, 30, 16], [0, 0, 1]]])
    before = render(gaussians, Cameras(torch.eye(4)[None], intrinsics), 32, 32)
    camera = Cameras(invert_rigid(to_from)[None], intrinsics)
    after = render(move_gaussians(gaussians, to_from), camera, 32, 32)
    assert before.alphas.mean() > 0.1
    torch.testing.assert_close(after.colors, before.colors, atol=1e-4, rtol=0)
