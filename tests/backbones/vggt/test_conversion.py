from dataclasses import replace

import pytest
import torch
from safetensors.torch import save_file
from torch.nn import functional

from instok3d.backbones.vggt import VGGTConfig, load_vggt_weights
from instok3d.backbones.vggt.conversion import KERNEL, POSITIONS, resize_kernel, to_patch_16
from tiny_vggt import TINY_VGGT, tiny_vggt

AT_14 = {"img_size": 56, "patch_size": 14}


def enlarged(patches: torch.Tensor, size: int) -> torch.Tensor:
    return functional.interpolate(
        patches, size=(size, size), mode="bicubic", antialias=True, align_corners=False
    )


def test_a_kernel_of_ones_keeps_its_sum():
    new = resize_kernel(torch.ones(1, 1, 14, 14), 16)
    assert new.sum().item() == pytest.approx(196, abs=1e-3)
    assert new.mean().item() == pytest.approx(0.7656, abs=1e-4)


def test_the_new_kernel_answers_to_the_enlarged_patch_as_the_old_one_to_the_patch(rng):
    kernel = torch.randn(5, 3, 14, 14, generator=rng)
    patches = torch.randn(7, 3, 14, 14, generator=rng)
    old = functional.conv2d(patches, kernel)
    new = functional.conv2d(enlarged(patches, 16), resize_kernel(kernel, 16))
    torch.testing.assert_close(new, old, atol=2e-5, rtol=1e-5)


def test_a_kernel_of_the_right_size_is_left_alone(rng):
    kernel = torch.randn(2, 3, 14, 14, generator=rng)
    assert resize_kernel(kernel, 14) is kernel


def test_to_patch_16_changes_the_kernel_and_the_positions_only():
    state = tiny_vggt(**AT_14).state_dict()
    state[POSITIONS] = torch.full_like(state[POSITIONS], 3.0)
    state[POSITIONS][:, 0] = -1
    converted = to_patch_16(state)
    assert converted[KERNEL].shape == (32, 3, 16, 16)
    expected = torch.full((1, 257, 32), 3.0)  # a constant stays constant: not pinv's 5.3 times it
    expected[:, 0] = -1  # the class token's stays first
    torch.testing.assert_close(converted[POSITIONS], expected)
    for name in state.keys() - {KERNEL, POSITIONS}:
        assert converted[name] is state[name]


@pytest.fixture
def published(tmp_path):
    """A tiny file of the published form: patches of 14 and a track head."""
    state = tiny_vggt(**AT_14).state_dict()
    state["track_head.tracker.corr_mlp.fc1.weight"] = torch.zeros(3)
    path = tmp_path / "vggt.safetensors"
    save_file(state, path)
    return path


def config(**changes) -> VGGTConfig:
    return replace(TINY_VGGT, **changes)


def test_a_published_file_is_read_without_its_track_head(published, rng):
    backbone = load_vggt_weights(published, config(**AT_14))
    assert not backbone.training
    images = torch.rand(1, 2, 3, 28, 42, generator=rng)
    with torch.no_grad():
        found, expected = backbone.vggt(images), tiny_vggt(**AT_14)(images)
    torch.testing.assert_close(found.world_points, expected.world_points)


def test_a_published_file_becomes_the_papers_network(published, rng):
    backbone = load_vggt_weights(published, config(intrinsics_token=True))
    assert backbone.patch_size == 16
    layer = backbone.vggt.aggregator.embed_intrinsics
    assert layer.bias.eq(0).all()
    assert layer.weight.std().item() == pytest.approx((2 / 9) ** 0.5, rel=0.3)
    state = tiny_vggt(**AT_14).state_dict()
    kernel = backbone.vggt.state_dict()[KERNEL]
    torch.testing.assert_close(kernel, resize_kernel(state[KERNEL], 16))
    output = backbone.vggt(torch.rand(1, 2, 3, 32, 48, generator=rng))
    assert output.world_points.isfinite().all()
    trained = {name for name, each in backbone.named_parameters() if each.requires_grad}
    frozen = {name for name, _ in backbone.named_parameters()} - trained
    assert frozen == {"vggt.aggregator.patch_embed.mask_token"}


def test_a_tensor_too_many_or_too_few_is_named(published, tmp_path):
    state = tiny_vggt(**AT_14).state_dict()
    save_file({**state, "wing": torch.zeros(1)}, published)
    with pytest.raises(ValueError, match="wing"):
        load_vggt_weights(published, config(**AT_14))
    del state["camera_head.trunk_norm.bias"]
    save_file(state, published)
    with pytest.raises(ValueError, match=r"camera_head\.trunk_norm\.bias"):
        load_vggt_weights(published, config(**AT_14))


def test_files_that_are_no_vggt_are_named(published, tmp_path):
    with pytest.raises(FileNotFoundError, match="give the safetensors file of VGGT-1B"):
        load_vggt_weights(tmp_path / "nowhere.safetensors")
    published.write_bytes(published.read_bytes()[:-8])
    with pytest.raises(ValueError, match="not a whole safetensors file"):
        load_vggt_weights(published)
    save_file({"x": torch.zeros(1)}, published)
    with pytest.raises(ValueError, match="is no VGGT: it has no aggregator"):
        load_vggt_weights(published)
