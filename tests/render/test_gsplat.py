"""gsplat on a GPU against the C++ kernels: pictures, maps, gradients."""

import pytest
import torch

from instok3d.render import render

CHANNELS = [1, 3, 31, 32, 33, 64, 100]


@pytest.mark.gpu
@pytest.mark.parametrize("channels", CHANNELS)
def test_maps_of_any_number_of_channels_and_their_gradients_are_those_of_the_kernels(
    make_scene, channels: int
):
    gaussians, cameras = make_scene(batch=2, count=200, dtype=torch.float32)
    # gsplat cuts alphas at 0.999 and the kernels at 0.99: no Gaussian reaches either.
    gaussians.opacities.mul_(0.9)
    weights = torch.randn(2, 2, channels, 24, 32)
    results = {}
    for device in ("cpu", "cuda"):
        on_device, features = (
            gaussians.to(device),
            torch.rand(2, 7, channels, generator=torch.Generator().manual_seed(0))
            .to(device)
            .requires_grad_(),
        )
        leaves = [features, on_device.means.requires_grad_(), on_device.opacities.requires_grad_()]
        out = render(on_device, cameras.to(device), 24, 32, anchor_features=features)
        assert out.features is not None
        loss = (out.features * weights.to(device)).sum() + out.colors.sum()
        gradients = torch.autograd.grad(loss, leaves)
        results[device] = [out.features.detach(), out.colors.detach(), *gradients]
    for found, expected in zip(results["cuda"], results["cpu"], strict=True):
        assert (found.cpu() - expected).norm() <= 0.01 * expected.norm()
