import json
import math
import re

import pytest
import torch
from safetensors import safe_open

from instok3d.backbones.vggt import VGGT, VGGTConfig
from instok3d.backbones.vggt.camera_head import decode_cameras
from instok3d.backbones.vggt.dense_head import ResidualUnit, position_waves
from instok3d.backbones.vggt.image_encoder import positions_for
from instok3d.backbones.vggt.layers import rotary_table, rotate
from tiny_vggt import tiny_vggt

ANSWERS = ("pose_enc", "world_points", "world_points_conf", "depth", "depth_conf")


@pytest.fixture(scope="module")
def stored(shared):
    path = shared / "fixtures" / "vggt_tiny_p14.safetensors"
    with safe_open(path, framework="pt") as stream:
        config = json.loads(stream.metadata()["config"])
        return config, {name: stream.get_tensor(name) for name in stream.keys()}  # noqa: SIM118


def answers(network: VGGT, images: torch.Tensor) -> dict[str, torch.Tensor]:
    with torch.no_grad():
        output = network(images)
    named = {name: getattr(output, name) for name in ANSWERS}
    return named | {"feature_first": output.tokens[0], "feature_last": output.tokens[-1]}


@pytest.mark.parametrize("case", [0, 1, 2])
def test_weights_of_the_published_form_give_its_numbers(stored, case):
    config, tensors = stored
    network = VGGT(VGGTConfig(**config)).eval()
    state = {name[6:]: value for name, value in tensors.items() if name.startswith("model.")}
    network.load_state_dict(state, strict=True)
    found = answers(network, tensors[f"case{case}.images"])
    for name, value in found.items():
        torch.testing.assert_close(value, tensors[f"case{case}.{name}"], atol=1e-5, rtol=0)


@pytest.fixture(scope="module")
def full_size() -> VGGT:
    with torch.device("meta"):
        return VGGT(VGGTConfig())


def millions(module) -> float:
    return sum(parameter.numel() for parameter in module.parameters()) / 1e6


def test_full_size_has_the_published_counts(full_size):
    trunk = full_size.aggregator
    assert millions(trunk.patch_embed) == pytest.approx(304.37, abs=0.005)
    assert millions(trunk.frame_blocks) == pytest.approx(302.36, abs=0.005)
    assert millions(trunk.global_blocks) == pytest.approx(302.36, abs=0.005)
    assert millions(full_size.camera_head) == pytest.approx(216.17, abs=0.005)
    assert millions(full_size.point_head) == pytest.approx(32.65, abs=0.005)
    assert millions(full_size.depth_head) == pytest.approx(32.65, abs=0.005)
    # The whole file has 1,256.54 M, of which the track head's 65.9 M are not ours.
    assert millions(full_size) == pytest.approx(1256.54 - 65.9, abs=0.1)


def test_full_size_has_the_published_names_and_shapes(full_size):
    shapes = {name: tuple(value.shape) for name, value in full_size.state_dict().items()}
    block = {
        "norm1.weight": (1024,), "norm1.bias": (1024,), "attn.qkv.weight": (3072, 1024),
        "attn.qkv.bias": (3072,), "attn.proj.weight": (1024, 1024), "attn.proj.bias": (1024,),
        "ls1.gamma": (1024,), "norm2.weight": (1024,), "norm2.bias": (1024,),
        "mlp.fc1.weight": (4096, 1024), "mlp.fc1.bias": (4096,), "mlp.fc2.weight": (1024, 4096),
        "mlp.fc2.bias": (1024,), "ls2.gamma": (1024,),
    }  # fmt: skip
    norms = {f"attn.{which}_norm.{part}": (64,) for which in "qk" for part in ("weight", "bias")}
    expected = {
        "aggregator.camera_token": (1, 2, 1, 1024),
        "aggregator.register_token": (1, 2, 4, 1024),
        "aggregator.patch_embed.cls_token": (1, 1, 1024),
        "aggregator.patch_embed.pos_embed": (1, 1370, 1024),
        "aggregator.patch_embed.register_tokens": (1, 4, 1024),
        "aggregator.patch_embed.mask_token": (1, 1024),
        "aggregator.patch_embed.patch_embed.proj.weight": (1024, 3, 14, 14),
        "aggregator.patch_embed.patch_embed.proj.bias": (1024,),
        "aggregator.patch_embed.norm.weight": (1024,),
        "aggregator.patch_embed.norm.bias": (1024,),
    }
    for number in range(24):
        for name, shape in block.items():
            expected[f"aggregator.patch_embed.blocks.{number}.{name}"] = shape
        for name, shape in (block | norms).items():
            expected[f"aggregator.frame_blocks.{number}.{name}"] = shape
            expected[f"aggregator.global_blocks.{number}.{name}"] = shape
    trunk = {name: shape for name, shape in shapes.items() if name.startswith("aggregator.")}
    assert trunk == expected
    assert shapes["camera_head.poseLN_modulation.1.weight"] == (6144, 2048)
    assert shapes["camera_head.pose_branch.fc2.weight"] == (9, 1024)
    assert shapes["camera_head.trunk.3.attn.qkv.weight"] == (6144, 2048)
    assert shapes["point_head.projects.1.weight"] == (512, 2048, 1, 1)
    assert shapes["point_head.scratch.refinenet1.resConfUnit1.conv1.weight"] == (256, 256, 3, 3)
    assert shapes["point_head.scratch.output_conv2.2.weight"] == (4, 32, 1, 1)
    assert shapes["depth_head.scratch.output_conv2.2.weight"] == (2, 32, 1, 1)


def test_full_size_heads_have_the_tiny_files_names(stored, full_size):
    # Where the depths are equal, so are the names; the trunk's are counted above.
    wanted = {name[6:] for name in stored[1] if re.match(r"model\.(camera|point|depth)_head", name)}
    found = {name for name in full_size.state_dict() if not name.startswith("aggregator")}
    assert found == wanted


def test_the_published_file_is_ours_and_the_track_head(full_size):
    # 2 tokens, encoder 24 x 14 + 8, 2 x 24 x 18 in the pairs, camera head 4 x 14 + 13, two dense
    # heads of 62: 1,403; the other 394 of the published 1,797 tensors are the track head's.
    assert len(full_size.state_dict()) == 2 + 344 + 864 + 69 + 124 == 1797 - 394


@pytest.mark.parametrize(
    ("batch", "views", "height", "width"),
    [(1, 1, 16, 16), (2, 3, 48, 80), (1, 16, 32, 48), (1, 2, 16, 256), (1, 2, 128, 112)],
)
def test_any_number_and_size_of_views(rng, batch, views, height, width):
    found = answers(tiny_vggt(), torch.rand(batch, views, 3, height, width, generator=rng))
    assert found["feature_last"].shape == (batch, views, 3 + height * width // 256, 64)
    assert found["world_points"].shape == (batch, views, height, width, 3)
    assert found["depth"].shape == (batch, views, height, width, 1)
    assert all(value.isfinite().all() for value in found.values())
    assert found["depth"].min() > 0
    assert found["depth_conf"].min() > 1


def test_a_size_that_is_no_multiple_of_the_patch_is_an_error():
    with pytest.raises(ValueError, match="32x40 pixels; this VGGT needs multiples of 16"):
        tiny_vggt()(torch.zeros(1, 1, 3, 32, 40))


def test_scenes_of_a_batch_do_not_see_each_other(rng):
    network, images = tiny_vggt(), torch.rand(2, 2, 3, 32, 32, generator=rng)
    both = answers(network, images)
    for scene in range(2):
        alone = answers(network, images[scene : scene + 1])
        for name, value in alone.items():
            torch.testing.assert_close(both[name][scene], value[0], atol=1e-5, rtol=1e-5)


def test_views_after_the_first_may_come_in_any_order(rng):
    network, images = tiny_vggt(), torch.rand(1, 4, 3, 32, 32, generator=rng)
    order = [0, 3, 1, 2]
    plain, permuted = answers(network, images), answers(network, images[:, order])
    for name, value in plain.items():
        torch.testing.assert_close(permuted[name], value[:, order], atol=1e-5, rtol=1e-5)


def test_the_first_view_is_another_one_than_the_rest(rng):
    network, images = tiny_vggt(), torch.rand(1, 2, 3, 32, 32, generator=rng)
    plain, swapped = answers(network, images), answers(network, images.flip(1))
    assert (plain["feature_last"] - swapped["feature_last"].flip(1)).abs().max() > 0.1


def test_bfloat16_autocast_stays_near_float32_and_the_heads_stay_in_it(rng):
    network, images = tiny_vggt(), torch.rand(1, 2, 3, 64, 64, generator=rng)
    plain = answers(network, images)
    with torch.autocast("cpu", torch.bfloat16):
        low = answers(network, images)
        with torch.no_grad():
            tokens = network.aggregator(images, layers=range(2))
            inside = network.points(tokens, (64, 64))
    with torch.no_grad():
        outside = network.points(tokens, (64, 64))
    assert inside[0].equal(outside[0])
    assert all(value.dtype == torch.float32 and value.isfinite().all() for value in low.values())
    error = (low["feature_last"] - plain["feature_last"]).abs().mean()
    assert error < 0.03 * plain["feature_last"].abs().mean()


def test_a_trunk_in_bfloat16_feeds_heads_in_float32(rng):
    network, images = tiny_vggt(intrinsics_token=True), torch.rand(1, 2, 3, 32, 48, generator=rng)
    plain = answers(network, images)
    network.aggregator.to(torch.bfloat16)
    low = answers(network, images)
    assert low.pop("feature_first").dtype == torch.bfloat16
    error = (low.pop("feature_last").float() - plain["feature_last"]).abs().mean()
    assert error < 0.03 * plain["feature_last"].abs().mean()
    assert all(value.dtype == torch.float32 and value.isfinite().all() for value in low.values())


def test_recomputing_blocks_changes_no_gradient(rng):
    images = torch.rand(1, 2, 3, 32, 32, generator=rng)
    gradients = []
    for recompute in (False, True):
        network = tiny_vggt(checkpoint_blocks=recompute)
        network(images).world_points.square().mean().backward()
        gradients.append({n: p.grad for n, p in network.named_parameters() if p.grad is not None})
    assert gradients[0].keys() == gradients[1].keys()
    for name, value in gradients[0].items():
        torch.testing.assert_close(gradients[1][name], value)


def test_gradient_reaches_every_parameter_but_the_mask_token_and_the_first_pose(rng):
    network = tiny_vggt()
    output = network(torch.rand(1, 2, 3, 32, 32, generator=rng))
    answers = [output.pose_enc, output.world_points, output.world_points_conf]
    answers += [output.depth, output.depth_conf]
    sum(each.square().mean() for each in answers).backward()
    without = {name for name, each in network.named_parameters() if each.grad is None}
    # The mask token is for another training; rounds after the first take poses as numbers.
    assert without == {"aggregator.patch_embed.mask_token", "camera_head.empty_pose_tokens"}


def test_the_skip_of_a_residual_unit_is_rectified():
    # With convolutions that are zero only the skip is left: relu(x), not x.
    unit = ResidualUnit(1)
    for parameter in unit.parameters():
        torch.nn.init.zeros_(parameter)
    x = torch.tensor([[[[-1.0, 2.0]]]])
    assert unit(x).tolist() == [[[[0.0, 2.0]]]]
    assert x.tolist() == [[[[-1.0, 2.0]]]]  # and its input is left alone


def test_rotation_by_hand():
    # Head of 8 channels: 4 turn with y, 4 with x, frequencies 1 and 100^(-1/2) = 0.1.
    table = rotary_table(torch.tensor([[2, 0]]), 8)
    turned = rotate(torch.tensor([1.0, 1, 0, 0, 1, 1, 0, 0]).view(1, 1, 1, 8), table)
    by_hand = [math.cos(2), math.cos(0.2), math.sin(2), math.sin(0.2), 1, 1, 0, 0]
    torch.testing.assert_close(turned.flatten(), torch.tensor(by_hand))


def test_rotated_products_depend_on_the_difference_of_places(rng):
    query, key = torch.randn(2, 1, 1, 1, 16, generator=rng).unbind(0)

    def product(y: int, x: int) -> torch.Tensor:
        near = rotate(query, rotary_table(torch.tensor([[y, x]]), 16))
        far = rotate(key, rotary_table(torch.tensor([[y + 3, x + 5]]), 16))
        return (near * far).sum()

    torch.testing.assert_close(product(0, 0), product(7, 11), atol=1e-5, rtol=1e-5)


def test_the_stored_position_embedding_is_used_as_it_is_on_its_own_grid_only(rng):
    stored = torch.randn(1, 17, 3, generator=rng)
    assert positions_for(stored, 4, 4) is stored
    # As many patches in another shape are another grid.
    assert (positions_for(stored, 2, 8) - stored).abs().max() > 0.1


def test_a_constant_position_embedding_stays_constant_and_the_class_token_first():
    stored = torch.full((1, 17, 3), 2.0)
    stored[:, 0] = -5
    resized = positions_for(stored, 3, 7)
    assert resized.shape == (1, 22, 3)
    assert (resized[:, 0] == -5).all()
    torch.testing.assert_close(resized[:, 1:], torch.full((1, 21, 3), 2.0))


def cubic_weights(old: int, new: int) -> torch.Tensor:
    """[new, old]: Keys' cubic with a = -1/2 around each new cell, stretched where it shrinks."""
    stretch = max(old / new, 1.0)
    weights = torch.zeros(new, old, dtype=torch.float64)
    for row in range(new):
        for column in range(old):
            x = abs((column + 0.5 - (row + 0.5) * old / new) / stretch)
            if x < 1:
                weights[row, column] = 1.5 * x**3 - 2.5 * x**2 + 1
            elif x < 2:
                weights[row, column] = -0.5 * x**3 + 2.5 * x**2 - 4 * x + 2
    return weights / weights.sum(dim=1, keepdim=True)


@pytest.mark.parametrize(("rows", "columns"), [(3, 7), (7, 3), (6, 2), (1, 5)])
def test_positions_of_a_grid_that_is_not_square_are_cubic_in_rows_and_in_columns(
    rng, rows, columns
):
    stored = torch.randn(1, 1 + 25, 2, generator=rng)
    grid = stored[0, 1:].double().view(5, 5, 2)
    expected = torch.einsum(
        "ri,cj,ijk->rck", cubic_weights(5, rows), cubic_weights(5, columns), grid
    )
    found = positions_for(stored, rows, columns)[0, 1:].view(rows, columns, 2)
    torch.testing.assert_close(found.double(), expected, atol=1e-5, rtol=1e-5)


def test_position_waves_by_hand():
    # A square of 2 x 2 cells: half the diagonal is 1, so x and y are +-1/sqrt(2) * 1/2.
    # 4 channels: one frequency, 1; sin x, cos x, sin y, cos y.
    place = 0.5 / math.sqrt(2)
    waves = position_waves(2, 2, 4, 1.0, like=torch.zeros(1))
    x = torch.tensor([[-place, place], [-place, place]])
    torch.testing.assert_close(waves, torch.stack([x.sin(), x.cos(), x.mT.sin(), x.mT.cos()]))


def test_dense_scales_of_256_pixels_are_64_32_16_8_cells(rng):
    network = tiny_vggt()
    head, sizes = network.point_head, []
    fuse = head.scratch.fuse
    head.scratch.fuse = lambda scales: sizes.extend(s.shape[-1] for s in scales) or fuse(scales)
    assert answers(network, torch.rand(1, 1, 3, 256, 256, generator=rng))["world_points"].shape == (
        1,
        1,
        256,
        256,
        3,
    )
    assert sizes == [64, 32, 16, 8]


def test_cameras_of_a_pose_encoding_by_hand():
    # A quarter turn about z is (0, 0, s, s) in xyzw with s = 1/sqrt(2): x goes to y.
    half = math.sqrt(0.5)
    pose = torch.tensor([[[1.0, 2, 3, 0, 0, half, half, math.pi / 2, 2 * math.atan(0.5)]]])
    cameras = decode_cameras(pose, 48, 80)
    expected = [[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    torch.testing.assert_close(cameras.cam_from_world[0, 0], torch.tensor(expected))
    # fy = 24 / tan(45 deg) = 24; fx = 40 / 0.5 = 80; centre (40, 24).
    expected = [[80.0, 0, 40], [0, 24, 24], [0, 0, 1]]
    torch.testing.assert_close(cameras.intrinsics[0, 0], torch.tensor(expected))


def test_a_field_of_view_of_zero_still_gives_a_finite_camera():
    cameras = decode_cameras(torch.zeros(1, 1, 9), 48, 80)
    assert cameras.intrinsics.isfinite().all()
    assert cameras.cam_from_world.isfinite().all()


def test_sizes_that_make_no_network_are_refused():
    with pytest.raises(ValueError, match="img_size 60 is no multiple of patch_size 16"):
        VGGTConfig(img_size=60, patch_size=16)
    with pytest.raises(ValueError, match=r"embed_dim 36 must be a multiple of 4 x num_heads"):
        VGGTConfig(embed_dim=36, num_heads=2)
    with pytest.raises(ValueError, match="must lie in 0 to 3"):
        VGGTConfig(depth=4)
    with pytest.raises(ValueError, match="name four scales"):
        VGGTConfig(dpt_layers=(1, 2))
    with pytest.raises(ValueError, match="dpt_features must be a multiple of 8"):
        VGGTConfig(dpt_features=20)
