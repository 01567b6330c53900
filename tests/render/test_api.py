import warnings

import pytest
import torch

from instok3d.render import RasterSettings, api, native_backend, render
from instok3d.render.native_backend import NativeStatus
from instok3d.types import Cameras, Gaussians


def test_without_the_kernels_the_first_render_warns_once_and_says_what_to_do(
    make_scene, monkeypatch
):
    gaussians, cameras = make_scene(count=5, dtype=torch.float32)
    monkeypatch.setattr(native_backend, "_rasterizer", None)
    monkeypatch.setattr(native_backend, "find_spec", lambda name: None)
    api._warn_of_slow_rendering.cache_clear()
    with pytest.warns(UserWarning, match=r"hundreds of times.*not built.*C\+\+ compiler"):
        render(gaussians, cameras, 8, 8)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        render(gaussians, cameras, 8, 8)


def test_backend_follows_dtype_device_and_settings(monkeypatch):
    monkeypatch.setattr(
        api, "native_status", lambda: NativeStatus(True, ("portable",), "OpenMP", "")
    )
    cpu, cuda = torch.device("cpu"), torch.device("cuda")
    smooth = RasterSettings(alpha_min=0.0)
    assert api._chosen("auto", torch.float32, cpu, RasterSettings()) == "native"
    assert api._chosen("auto", torch.float64, cpu, RasterSettings()) == "reference"
    assert api._chosen("auto", torch.float32, cpu, smooth) == "reference"
    assert api._chosen("auto", torch.float32, cuda, RasterSettings()) == "gsplat"
    assert api._chosen("reference", torch.float32, cuda, RasterSettings()) == "reference"


def test_sizes_that_do_not_fit_are_named(make_scene):
    gaussians, cameras = make_scene(count=5)
    batched, batched_cameras = make_scene(batch=2, count=5)
    with pytest.raises(ValueError, match=r"cameras\.cam_from_world has the shape \(2, 2, 4, 4\)"):
        render(gaussians, batched_cameras, 8, 8)
    with pytest.raises(ValueError, match=r"anchor_features have the shape \(7, 3\)"):
        render(batched, batched_cameras, 8, 8, anchor_features=torch.zeros(7, 3))
    with pytest.raises(ValueError, match="height and width"):
        render(gaussians, cameras, 0, 8)
    # Past the checks of the types, which only run in tests.
    object.__setattr__(cameras, "intrinsics", cameras.intrinsics[:1])
    with pytest.raises(ValueError, match="1 intrinsics and 2 cam_from_world"):
        render(gaussians, cameras, 8, 8)
    object.__setattr__(gaussians, "opacities", gaussians.opacities[:3])
    with pytest.raises(ValueError, match=r"gaussians\.opacities has the shape \(3,\)"):
        render(gaussians, cameras, 8, 8)


def test_thresholds_out_of_order_are_refused():
    with pytest.raises(ValueError, match="alpha_min < alpha_max"):
        RasterSettings(alpha_min=0.9, alpha_max=0.5)
    with pytest.raises(ValueError, match="transmittance_min"):
        RasterSettings(transmittance_min=1.0)
    with pytest.raises(ValueError, match="alpha_max < 1"):
        RasterSettings(alpha_max=1.0)
    with pytest.raises(ValueError, match="eps2d must not be negative"):
        RasterSettings(eps2d=-0.1)
    assert RasterSettings(eps2d=0.0).eps2d == 0


def test_gsplat_asks_for_a_cuda_device_and_for_its_own_thresholds(make_scene):
    gaussians, cameras = make_scene(count=5, dtype=torch.float32)
    with pytest.raises(ValueError, match="CUDA device, got cpu"):
        render(gaussians, cameras, 8, 8, backend="gsplat")
    with pytest.raises(ValueError, match="fixed thresholds"):
        render(gaussians, cameras, 8, 8, settings=RasterSettings(alpha_max=0.5), backend="gsplat")


@pytest.mark.gpu
def test_gsplat_is_the_reference_up_to_its_alpha_limit(make_scene):
    gaussians, cameras = make_scene(batch=2, count=200, dtype=torch.float32)
    features = torch.rand(2, 7, 40)
    on_gpu = render(
        Gaussians(**{name: value.cuda() for name, value in vars(gaussians).items()}),
        Cameras(cameras.cam_from_world.cuda(), cameras.intrinsics.cuda()),
        24, 32, anchor_features=features.cuda(),
    )  # fmt: skip
    expected = render(gaussians, cameras, 24, 32, anchor_features=features, backend="reference")
    for name, value in vars(expected).items():
        error = (vars(on_gpu)[name].cpu() - value).abs()
        assert error.max() <= 0.02 * value.abs().max()
