from dataclasses import replace

import pytest
import torch
from torch import Tensor

from instok3d.model.anchors import gather_rows
from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.tokenizer import Tokenizer, TokenizerConfig
from instok3d.types import Geometry, TokenGroups, Views
from plane_backbone import PlaneBackbone, PlaneConfig

SMALL = TokenizerConfig(
    width=32,
    num_anchors=20,
    num_groups=6,
    window_views=0,
    anchor_layers=2,
    group_layers=1,
    head_size=16,
    gaussian_head=GaussianHeadConfig(gaussians_per_anchor=4),
)


def small_tokenizer(**changes) -> Tokenizer:
    torch.manual_seed(0)
    return Tokenizer(PlaneBackbone(PlaneConfig()), replace(SMALL, **changes))


def photos(rng: torch.Generator, *, batch: int = 2, views: int = 2, size: int = 32) -> Views:
    return Views(torch.rand(batch, views, 3, size, size, generator=rng))


def loss_of_everything(groups: TokenGroups) -> Tensor:
    gaussians = groups.gaussians
    parts = [gaussians.means, gaussians.scales, gaussians.quats, gaussians.opacities, gaussians.sh]
    weights = torch.Generator().manual_seed(1)
    loss = (groups.assignment * torch.rand(groups.assignment.shape, generator=weights)).sum()
    return loss + sum((part * torch.rand(part.shape, generator=weights)).sum() for part in parts)


@pytest.mark.parametrize("views", [1, 5])
def test_shapes_for_one_and_for_five_views(rng, views):
    groups = small_tokenizer()(photos(rng, views=views))
    anchors = min(20, 16 * views)
    assert groups.anchors.tokens.shape == (2, anchors, 32)
    assert groups.tokens.shape == (2, 6, 32)
    assert groups.assignment.shape == (2, anchors, 7)
    assert groups.gaussians.means.shape == (2, anchors * 4, 3)
    assert groups.gaussians.sh.shape == (2, anchors * 4, 4, 3)
    assert groups.gaussians.anchor_index[0].bincount().tolist() == [4] * anchors


def test_in_metres_the_papers_bounds_are_metres(rng):
    head = GaussianHeadConfig(gaussians_per_anchor=4, seeding="anchor")
    model = small_tokenizer(gaussian_head=head, normalize_scale=False)
    with torch.no_grad():
        model.gaussian_head.out.weight.mul_(1000)  # far beyond every bound
    views = photos(rng)
    geometry = model.backbone(views)
    geometry = replace(geometry, pointmaps=5 * geometry.pointmaps)
    groups = model(views, geometry)
    middle = geometry.pointmaps[:, :, 4::8, 4::8].reshape(2, 32, 3)
    torch.testing.assert_close(
        groups.anchors.positions, gather_rows(middle, groups.anchors.patches)
    )
    offsets = groups.gaussians.means - groups.anchors.positions.repeat_interleave(4, dim=1)
    assert offsets.abs().max().item() == pytest.approx(0.1, abs=1e-5)
    assert groups.gaussians.scales.max().item() == pytest.approx(0.3, abs=1e-5)


def test_rows_of_the_assignment_sum_to_one_under_autocast_too(rng):
    with torch.autocast("cpu", torch.bfloat16):
        groups = small_tokenizer()(photos(rng))
    assert groups.assignment.dtype == torch.float32
    torch.testing.assert_close(groups.assignment.sum(-1), torch.ones(2, 20))
    for name in ("means", "scales", "quats", "opacities", "sh"):
        assert getattr(groups.gaussians, name).dtype == torch.float32, name


@pytest.mark.parametrize("seeding", ["surface", "anchor"])
def test_gradient_reaches_every_parameter(rng, seeding):
    model = small_tokenizer(
        gaussian_head=GaussianHeadConfig(gaussians_per_anchor=4, seeding=seeding),
        anchor_self_attention=True,
        normalize_heads=True,
    )
    loss_of_everything(model(photos(rng))).backward()
    untouched = [
        name
        for name, parameter in model.named_parameters()
        if parameter.grad is None or not parameter.grad.abs().sum() > 0
    ]
    assert untouched == []


def doubled(geometry: Geometry) -> Geometry:
    cam_from_world = geometry.cameras.cam_from_world.clone()
    cam_from_world[..., :3, 3] *= 2
    return replace(
        geometry,
        depths=2 * geometry.depths,
        pointmaps=2 * geometry.pointmaps,
        cameras=replace(geometry.cameras, cam_from_world=cam_from_world),
    )


@pytest.mark.parametrize("seeding", ["surface", "anchor"])
def test_twice_the_room_gives_twice_the_gaussians(rng, seeding):
    head = GaussianHeadConfig(gaussians_per_anchor=4, seeding=seeding)
    model, views = small_tokenizer(gaussian_head=head).eval(), photos(rng)
    geometry = model.backbone(views)
    once, twice = model(views, geometry), model(views, doubled(geometry))
    torch.testing.assert_close(twice.gaussians.means, 2 * once.gaussians.means)
    torch.testing.assert_close(twice.gaussians.scales, 2 * once.gaussians.scales)
    torch.testing.assert_close(twice.anchors.positions, 2 * once.anchors.positions)
    torch.testing.assert_close(twice.gaussians.sh, once.gaussians.sh)
    torch.testing.assert_close(twice.assignment, once.assignment)


def test_a_scene_does_not_see_the_others_of_its_batch(rng):
    model, views = small_tokenizer(), photos(rng, batch=3)
    together, alone = model(views), model(Views(views.images[1:2]))
    torch.testing.assert_close(together.gaussians.means[1:2], alone.gaussians.means)
    torch.testing.assert_close(together.assignment[1:2], alone.assignment)


def test_kept_geometry_gives_what_the_backbone_gives(rng):
    model, views = small_tokenizer(), photos(rng)
    kept = model(views, model.backbone(views))
    torch.testing.assert_close(kept.gaussians.means, model(views).gaussians.means)


def test_points_that_are_not_finite_do_no_harm(rng):
    model, views = small_tokenizer(), photos(rng)
    geometry = model.backbone(views)
    geometry.pointmaps[0, 0, :12] = torch.inf
    geometry.pointmaps[0, 1, 3:5, 3] = torch.nan
    groups = model(views, geometry)
    loss_of_everything(groups).backward()
    assert groups.gaussians.means.isfinite().all()
    assert all(p.grad.isfinite().all() for p in model.own_parameters())


def test_a_size_that_is_no_multiple_of_the_patch_is_named(rng):
    views = Views(torch.rand(1, 1, 3, 32, 36, generator=rng))
    model = small_tokenizer()
    geometry = model.backbone(photos(rng, batch=1, views=1))
    with pytest.raises(ValueError, match=r"multiples of the patch size 8, got 32 x 36"):
        model(views, geometry)


def test_own_parameters_leave_the_backbone_out():
    model = small_tokenizer()
    own = sum(p.numel() for p in model.own_parameters())
    backbone = sum(p.numel() for p in model.backbone.parameters())
    assert own + backbone == sum(p.numel() for p in model.parameters())
    assert backbone > 0


def test_a_count_of_no_groups_is_refused():
    with pytest.raises(ValueError, match="num_groups must be at least 1"):
        TokenizerConfig(num_groups=0)
