from dataclasses import replace

import pytest
import torch

from instok3d.backbones.registry import build_backbone
from instok3d.backbones.vggt import VGGTBackbone
from instok3d.backbones.vggt.aggregator import relative_intrinsics
from instok3d.backbones.vggt.backbone import see_points
from instok3d.backbones.vggt.layers import rotary_table
from instok3d.geometry.cameras import (
    intrinsics_from_field_of_view,
    invert_rigid,
    relative_to_first,
    rigid,
    transform_points,
    unproject,
)
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.model.files import load_model, save_model
from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.tokenizer import Tokenizer, TokenizerConfig
from instok3d.types import Cameras, Views
from tiny_vggt import TINY_VGGT, enlivened, tiny_vggt


def tiny_backbone(**changes) -> VGGTBackbone:
    torch.manual_seed(0)
    backbone = build_backbone(replace(TINY_VGGT, **changes))
    assert isinstance(backbone, VGGTBackbone)
    enlivened(backbone.vggt)
    return backbone.eval()


def photos(rng, *, batch=1, views=3, height=32, width=48, **given) -> Views:
    return Views(torch.rand(batch, views, 3, height, width, generator=rng), **given)


def some_cameras(rng, *, batch=1, views=3) -> Cameras:
    """Around the origin, looking about; lenses of 1 radian."""
    quats = torch.tensor([1.0, 0, 0, 0]) + 0.2 * torch.randn(batch, views, 4, generator=rng)
    center = torch.randn(batch, views, 3, generator=rng)
    return Cameras(
        rigid(quat_to_matrix(quats), center),
        intrinsics_from_field_of_view(torch.ones(batch, views), 32, 48),
    )


def test_with_photos_alone_the_pointmaps_are_the_point_heads(rng):
    backbone, views = tiny_backbone(), photos(rng, batch=2)
    with torch.no_grad():
        geometry, output = backbone(views), backbone.vggt(views.images)
    torch.testing.assert_close(geometry.pointmaps, output.world_points)
    torch.testing.assert_close(geometry.confidences, output.world_points_conf)
    torch.testing.assert_close(geometry.features, output.tokens[-1][:, :, 3:])
    assert backbone.feature_channels == geometry.features.shape[-1] == 64
    assert geometry.depths.shape == (2, 3, 32, 48)
    assert geometry.depths.min() > 0
    first = geometry.cameras.cam_from_world[:, 0]
    torch.testing.assert_close(first, torch.eye(4).expand(2, 4, 4))


def test_with_depths_the_pointmaps_are_the_depth_heads(rng):
    backbone, views = tiny_backbone(geometry_from="depths"), photos(rng)
    with torch.no_grad():
        geometry, output = backbone(views), backbone.vggt(views.images)
    torch.testing.assert_close(geometry.depths, output.depth[..., 0])
    expected = unproject(geometry.depths, geometry.cameras.intrinsics)[:, 0]
    torch.testing.assert_close(geometry.pointmaps[:, 0], expected)


@pytest.mark.parametrize("mode", ["points", "depths"])
def test_what_is_given_stands(rng, mode):
    backbone, cameras = tiny_backbone(geometry_from=mode), some_cameras(rng)
    depths = 1 + torch.rand(1, 3, 32, 48, generator=rng)
    depths[..., :10] = 0
    views = photos(
        rng, depths=depths, cam_from_world=cameras.cam_from_world, intrinsics=cameras.intrinsics
    )
    with torch.no_grad():
        geometry = backbone(views)
    known = depths > 0
    torch.testing.assert_close(geometry.depths[known], depths[known])
    assert geometry.depths.min() > 0
    given = relative_to_first(cameras.cam_from_world)
    torch.testing.assert_close(geometry.cameras.cam_from_world, given)
    torch.testing.assert_close(geometry.cameras.intrinsics, cameras.intrinsics)
    seen = unproject(geometry.depths, cameras.intrinsics)
    expected = transform_points(invert_rigid(given), seen.flatten(2, 3)).view_as(seen)
    torch.testing.assert_close(geometry.pointmaps, expected)


def test_a_pointmap_tells_where_its_cameras_were(rng):
    # Points made from cameras and depths; the network's translations are off by a factor of 7.
    cameras = some_cameras(rng, batch=2)
    true = relative_to_first(cameras.cam_from_world)
    depths = 1 + torch.rand(2, 3, 32, 48, generator=rng)
    in_camera = unproject(depths, cameras.intrinsics)
    points = transform_points(invert_rigid(true), in_camera.flatten(2, 3)).view_as(in_camera)
    wrong = cameras.cam_from_world.clone()
    wrong[..., :3, 3] *= 7
    seen = see_points(points, torch.ones_like(depths), Cameras(wrong, cameras.intrinsics))
    torch.testing.assert_close(seen.cameras.cam_from_world, true, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(seen.depths, depths, atol=1e-4, rtol=1e-4)


def test_points_that_are_not_finite_do_not_move_the_cameras(rng):
    cameras = some_cameras(rng)
    points = unproject(2 + torch.rand(1, 3, 32, 48, generator=rng), cameras.intrinsics)
    sure = torch.ones(1, 3, 32, 48)
    expected = see_points(points[:, :, :, 1:], sure[..., 1:], shifted(cameras)).cameras
    points[:, :, :, 0] = torch.inf
    found = see_points(points, sure, cameras).cameras
    torch.testing.assert_close(found.cam_from_world, expected.cam_from_world, atol=1e-3, rtol=1e-3)


def shifted(cameras: Cameras) -> Cameras:
    """The same for images without their first column of pixels."""
    intrinsics = cameras.intrinsics.clone()
    intrinsics[..., 0, 2] -= 1
    return Cameras(cameras.cam_from_world, intrinsics)


def test_a_single_view_stands_at_the_origin(rng):
    geometry = tiny_backbone()(photos(rng, views=1))
    torch.testing.assert_close(geometry.cameras.cam_from_world, torch.eye(4)[None, None])
    z = geometry.pointmaps[..., 2].clamp_min(1e-4)
    torch.testing.assert_close(geometry.depths, z)


def test_intrinsics_as_the_network_reads_them_by_hand():
    matrix = torch.tensor([[50.0, 2, 30], [0, 60, 15], [0, 0, 1]])
    expected = torch.tensor([50 / 80, 2 / 80, 30 / 80, 0, 60 / 40, 15 / 40, 0, 0, 1])
    torch.testing.assert_close(relative_intrinsics(matrix, height=40, width=80), expected)


def test_known_intrinsics_change_the_answer_and_their_token_is_not_returned(rng):
    backbone, cameras = tiny_backbone(intrinsics_token=True), some_cameras(rng)
    views = photos(rng)
    told = replace(views, intrinsics=cameras.intrinsics)
    with torch.no_grad():
        unknown, known = backbone(views), backbone(told)
        output = backbone.vggt(views.images, cameras.intrinsics)
    assert output.tokens[0].shape == (1, 3, 3 + 6, 64)
    assert known.features.shape == unknown.features.shape == (1, 3, 6, 64)
    assert (known.pointmaps - unknown.pointmaps).abs().max() > 1e-5
    torch.testing.assert_close(known.pointmaps, output.world_points)


def test_unknown_intrinsics_are_zeros(rng):
    network, images = tiny_vggt(intrinsics_token=True), photos(rng).images
    with torch.no_grad():
        unknown = network(images).world_points
        network.aggregator.embed_intrinsics.weight.zero_()
        known = network(images, some_cameras(rng).intrinsics).world_points
    torch.testing.assert_close(unknown, known)


def test_the_intrinsics_token_stands_below_the_first_column():
    aggregator = tiny_vggt(intrinsics_token=True).aggregator
    frame, all_views = aggregator._tables(16, 16, 3, torch.zeros(1))
    expected = rotary_table(torch.tensor([[17, 1]]), 16)
    torch.testing.assert_close(frame.sine[-1:], expected.sine)
    torch.testing.assert_close(all_views.cosine[-1:], expected.cosine)
    assert all_views.cosine.shape[0] == 3 * frame.cosine.shape[0] == 3 * (3 + 256 + 1)


def test_without_the_token_intrinsics_are_kept_and_not_read(rng):
    backbone, cameras = tiny_backbone(), some_cameras(rng)
    views = photos(rng)
    with torch.no_grad():
        known = backbone(replace(views, intrinsics=cameras.intrinsics))
        torch.testing.assert_close(known.pointmaps, backbone(views).pointmaps)
    torch.testing.assert_close(known.cameras.intrinsics, cameras.intrinsics)


@pytest.mark.parametrize("mode", ["points", "depths"])
def test_adapted_parameters_are_those_that_get_a_gradient(rng, mode):
    backbone = tiny_backbone(geometry_from=mode, intrinsics_token=True)
    views = photos(rng, intrinsics=some_cameras(rng).intrinsics)
    geometry = backbone(views)
    (geometry.pointmaps.square().mean() + geometry.features.square().mean()).backward()
    reached = {id(each) for each in backbone.parameters() if each.grad is not None}
    assert reached == {id(each) for each in backbone.adapted_parameters()}


def test_a_model_with_vggt_is_saved_and_read(tmp_path, rng):
    config = TokenizerConfig(
        width=32, num_anchors=4, num_groups=3, anchor_layers=1, group_layers=1, head_size=16,
        gaussian_head=GaussianHeadConfig(gaussians_per_anchor=4, sh_degree=1),
    )  # fmt: skip
    model = Tokenizer(tiny_backbone(intrinsics_token=True), config).eval()
    path = tmp_path / "model.safetensors"
    save_model(model, path, card={}, half=False)
    again = load_model(path)
    assert again.backbone.config == model.backbone.config
    views = photos(rng)
    with torch.no_grad():
        torch.testing.assert_close(again(views).gaussians.means, model(views).gaussians.means)
