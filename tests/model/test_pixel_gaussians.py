from dataclasses import replace

import pytest
import torch

from instok3d.geometry.spherical_harmonics import SH_CONSTANT
from instok3d.model.pixel_gaussians import (
    INITIAL_SCALE_PIXELS,
    LARGEST_CHANGE,
    PixelGaussianConfig,
    PixelGaussianHead,
    PixelGaussians,
)
from instok3d.types import Views
from plane_backbone import PlaneBackbone, PlaneConfig


def model(**changes) -> PixelGaussians:
    torch.manual_seed(0)
    return PixelGaussians(PlaneBackbone(PlaneConfig()), PixelGaussianConfig(width=8, **changes))


def photos(rng: torch.Generator, views: int = 2) -> Views:
    return Views(torch.rand(2, views, 3, 16, 24, generator=rng))


@pytest.mark.parametrize("views", [1, 3])
def test_every_pixel_becomes_a_gaussian_on_its_point(rng, views):
    scene = model()(photos(rng, views))
    gaussians, pixels = scene.gaussians, views * 16 * 24
    assert torch.equal(gaussians.means, scene.geometry.pointmaps.reshape(2, pixels, 3))
    assert gaussians.sh.shape == (2, pixels, 9, 3)
    torch.testing.assert_close(gaussians.quats.norm(dim=-1), torch.ones(2, pixels))
    assert ((gaussians.opacities > 0) & (gaussians.opacities < 1)).all()


def test_before_training_colours_and_sizes_are_the_pixels_own(rng):
    network, views = model(), photos(rng)
    torch.nn.init.zeros_(network.head.out.weight)
    scene = network(views)
    colors = scene.gaussians.sh[:, :, 0] * SH_CONSTANT + 0.5
    torch.testing.assert_close(colors, views.images.permute(0, 1, 3, 4, 2).reshape(2, -1, 3))
    # View 0, row 0, column 0: distance over focal length is the side of a pixel there.
    point = scene.geometry.pointmaps[0, 0, 0, 0]
    side = point.norm() / scene.geometry.cameras.intrinsics[0, 0, 0, 0]
    torch.testing.assert_close(
        scene.gaussians.scales[0, 0], (INITIAL_SCALE_PIXELS * side).expand(3)
    )


def test_scales_stay_within_their_bounds(rng):
    network = model(scale_max=0.02)
    torch.nn.init.normal_(network.head.out.weight, std=100.0)
    scales = network(photos(rng)).gaussians.scales.detach()
    assert scales.max().item() == pytest.approx(0.02)
    assert scales.min() >= 0.6 * 2 / 30 * torch.tensor(-LARGEST_CHANGE).exp() / 4


def test_gradient_reaches_the_pointmaps_and_every_parameter_of_the_head(rng):
    network, views = model(), photos(rng)
    geometry = network.backbone(views)
    geometry = replace(geometry, pointmaps=geometry.pointmaps.clone().requires_grad_())
    gaussians = network.head(views, geometry)
    names = ("means", "scales", "quats", "opacities", "sh")
    parts = [getattr(gaussians, name) for name in names]
    sum((part * torch.rand(part.shape, generator=rng)).sum() for part in parts).backward()
    assert geometry.pointmaps.grad.abs().min() > 0
    untouched = [n for n, p in network.head.named_parameters() if not p.grad.abs().sum() > 0]
    assert untouched == []


def test_a_point_that_is_not_finite_cannot_be_seen(rng):
    network, views = model(), photos(rng)
    geometry = network.backbone(views)
    geometry.pointmaps[0, 1, 3, 5] = torch.inf
    gaussians = network.head(views, geometry)
    assert gaussians.means.isfinite().all()
    assert (gaussians.opacities == 0).nonzero().tolist() == [[0, 16 * 24 + 3 * 24 + 5]]
    gaussians.opacities.sum().backward()
    assert all(p.grad is None or p.grad.isfinite().all() for p in network.parameters())


@pytest.mark.parametrize(("patch_size", "doublings"), [(1, 0), (8, 2), (14, 3), (16, 3)])
def test_patches_of_any_size_are_enlarged_to_the_image(rng, patch_size, doublings):
    backbone = PlaneBackbone(PlaneConfig(patch_size=patch_size, channels=4))
    network = PixelGaussians(backbone, PixelGaussianConfig(width=4, sh_degree=0))
    assert len(network.head.enlarge) == doublings
    views = Views(torch.rand(1, 1, 3, 2 * patch_size, 3 * patch_size, generator=rng))
    assert network(views).gaussians.sh.shape == (1, 6 * patch_size**2, 1, 3)


def test_features_of_another_patch_size_are_named(rng):
    views = photos(rng)
    geometry = PlaneBackbone(PlaneConfig(patch_size=4))(views)
    head = PixelGaussianHead(16, 8, PixelGaussianConfig(width=8))
    with pytest.raises(ValueError, match="do not give 24 patches of 8 pixels"):
        head(views, geometry)
