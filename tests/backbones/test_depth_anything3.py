import sys
from dataclasses import replace

import pytest
import torch
from safetensors.torch import save_file

from instok3d.backbones.depth_anything3 import (
    SIZES,
    DepthAnything3Backbone,
    DepthAnything3Config,
    load_depth_anything3_weights,
)
from instok3d.backbones.registry import build_backbone
from instok3d.geometry.cameras import intrinsics_from_field_of_view
from instok3d.training.checkpoint import read_weights
from instok3d.training.first_weights import load_backbone
from instok3d.types import Views

TINY = DepthAnything3Config(size="tiny")


@pytest.fixture(scope="module")
def backbone() -> DepthAnything3Backbone:
    pytest.importorskip("depth_anything_3", reason="the package depth-anything-3 is not installed")
    torch.manual_seed(0)
    built = build_backbone(TINY)
    assert isinstance(built, DepthAnything3Backbone)
    return built.eval()


def photos(rng, *, views=3, height=28, width=42, **given) -> Views:
    return Views(torch.rand(2, views, 3, height, width, generator=rng), **given)


@pytest.mark.parametrize("views", [1, 2, 4])
def test_photos_become_a_geometry(backbone, rng, views):
    with torch.no_grad():
        geometry = backbone(photos(rng, views=views))
    assert geometry.features.shape == (2, views, 6, backbone.feature_channels)
    assert geometry.pointmaps.shape == (2, views, 28, 42, 3)
    assert geometry.pointmaps.isfinite().all()
    assert geometry.depths.min() > 0
    assert geometry.confidences.min() > 0
    first = geometry.cameras.cam_from_world[:, 0]
    torch.testing.assert_close(first, torch.eye(4).expand(2, 4, 4), atol=1e-5, rtol=0)


def test_features_and_depths_come_in_the_order_of_the_views(backbone, rng):
    views = photos(rng, views=4)
    order = [0, 2, 3, 1]
    with torch.no_grad():
        plain, permuted = backbone(views), backbone(replace(views, images=views.images[:, order]))
    for name in ("features", "depths"):
        expected = getattr(plain, name)[:, order]
        torch.testing.assert_close(getattr(permuted, name), expected, atol=1e-4, rtol=1e-4)
    assert (plain.features[:, 1] - plain.features[:, 2]).abs().max() > 1e-3


def test_what_is_given_stands(backbone, rng):
    depths = 1 + torch.rand(2, 3, 28, 42, generator=rng)
    intrinsics = intrinsics_from_field_of_view(torch.ones(2, 3), 28, 42)
    with torch.no_grad():
        geometry = backbone(photos(rng, depths=depths, intrinsics=intrinsics))
    torch.testing.assert_close(geometry.depths, depths)
    torch.testing.assert_close(geometry.cameras.intrinsics, intrinsics)


def test_under_autocast_the_geometry_stays_near_float32_and_in_it(backbone, rng):
    views = photos(rng)
    with torch.no_grad():
        plain = backbone(views)
        with torch.autocast("cpu", torch.bfloat16):
            narrow = backbone(views)
    for name in ("depths", "confidences", "pointmaps"):
        found = getattr(narrow, name)
        assert found.dtype == torch.float32
        torch.testing.assert_close(found, getattr(plain, name), atol=2e-2, rtol=1e-2)


def test_a_gradient_reaches_all_that_the_geometry_depends_on(backbone, rng):
    geometry = backbone(photos(rng))
    (geometry.pointmaps.sum() + geometry.confidences.sum()).backward()
    without = {name for name, p in backbone.named_parameters() if p.grad is None}
    backbone.zero_grad(set_to_none=True)
    # Given cameras and rays: what the package can do besides.
    assert all("cam_enc." in name or "_aux." in name for name in without)


def test_nothing_is_written_to_standard_output(backbone, rng, capsys):
    with torch.no_grad():
        backbone(photos(rng))
    assert capsys.readouterr().out == ""


def test_a_size_that_is_no_multiple_of_the_patch_is_an_error(backbone, rng):
    with pytest.raises(ValueError, match="30x42 pixels; Depth Anything 3 needs multiples of 14"):
        backbone(photos(rng, height=30))


def test_published_weights_are_read_whole(backbone, tmp_path):
    path = tmp_path / "model.safetensors"
    state = {f"model.{name}": value + 1 for name, value in backbone.net.state_dict().items()}
    save_file(state, path)
    again, first = load_depth_anything3_weights(path, TINY), DepthAnything3Backbone(TINY)
    load_backbone(first, read_weights(path))
    for name, value in again.net.state_dict().items():
        assert value.equal(state[f"model.{name}"])
        assert value.equal(first.net.state_dict()[name])
    del state["model.cam_dec.fc_t.bias"]
    save_file(state, path)
    with pytest.raises(ValueError, match=r"(?s)does not hold Depth .* tiny.*cam_dec\.fc_t\.bias"):
        load_depth_anything3_weights(path, TINY)
    with pytest.raises(FileNotFoundError, match="no weights"):
        load_depth_anything3_weights(tmp_path / "nowhere", TINY)


def published_config(size: str):
    from importlib.resources import files

    from depth_anything_3.cfg import load_config

    return load_config(str(files("depth_anything_3") / "configs" / f"da3-{size}.yaml"))


@pytest.mark.parametrize("size", ["small", "base"])
def test_the_named_sizes_are_the_packages(backbone, size):
    published, sizes = published_config(size), SIZES[size]
    assert published.net.out_layers == list(sizes.outputs)
    assert published.net.alt_start == published.net.rope_start == sizes.first_global
    assert published.cam_enc.dim_out == sizes.width
    assert published.head.features == sizes.dense_width
    assert published.head.out_channels == list(sizes.dense_channels)


def test_the_small_network_has_the_packages_tensors(backbone):
    from depth_anything_3.cfg import create_object

    theirs = create_object(published_config("small")).state_dict()
    ours = DepthAnything3Backbone(DepthAnything3Config(size="small")).net.state_dict()
    shapes = [{name: value.shape for name, value in each.items()} for each in (ours, theirs)]
    assert shapes[0] == shapes[1]


def test_without_the_package_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "depth_anything_3.model.cam_dec", None)
    with pytest.raises(ModuleNotFoundError, match="pip install --no-deps depth-anything-3"):
        DepthAnything3Backbone(TINY)
