"""The one call that renders, and the choice of the backend behind it."""

import warnings
from collections.abc import Callable, Sequence
from functools import cache
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.render.checks import check_background, check_picture, check_scene
from instok3d.render.gsplat_backend import gsplat_is_installed, render_gsplat
from instok3d.render.native_backend import SMALLEST_ALPHA_MIN, native_status, render_native
from instok3d.render.reference import render_reference
from instok3d.render.settings import RasterSettings
from instok3d.types import Cameras, Gaussians, Rendering

Backend = Literal["auto", "native", "reference", "gsplat"]

RENDERERS: dict[str, Callable[..., Rendering]] = {
    "native": render_native,
    "reference": render_reference,
    "gsplat": render_gsplat,
}


def render(
    gaussians: Gaussians,
    cameras: Cameras,
    height: int,
    width: int,
    *,
    anchor_features: Float[Tensor, "*batch anchor channel"] | None = None,
    background: Float[Tensor, " 3"] | Sequence[float] = (0.0, 0.0, 0.0),
    near: float = 0.05,
    far: float = 100.0,
    settings: RasterSettings = RasterSettings(),  # noqa: B008 - frozen
    backend: Backend = "auto",
) -> Rendering:
    """Pictures of one scene or of a batch of scenes, every view of all of them in one call.

    Differentiable in means, scales, quats, opacities, sh, anchor_features and cam_from_world;
    not in the intrinsics or the background. Gaussians with a NaN or an infinity anywhere are
    not drawn and have zero gradients. Half-precision tensors are rendered in float32, also
    inside autocast.

    Args:
        gaussians: With one leading batch axis or without.
        cameras: With the same leading batch axis, or without.
        height: Of the pictures, pixels.
        width: Of the pictures, pixels.
        anchor_features: Composited through the anchors that the Gaussians came from (Sec. 3.2);
            group probabilities, for example.
        background: sRGB colour behind everything.
        near: Only Gaussians whose mean is farther than this z-depth are drawn, scene units.
        far: And nearer than this.
        settings: Thresholds.
        backend: "auto" takes gsplat for CUDA tensors, else the native kernels where they are
            built and the tensors are not float64, else the PyTorch reference.

    Raises:
        ValueError: Sizes, devices or types that do not fit together, near and far out of order,
            a picture of more than checks.MAX_PIXELS pixels, or an anchor index without a
            feature row.
    """
    check_picture(height, width, near, far)
    check_scene(gaussians, cameras, anchor_features)
    batched = gaussians.means.ndim == 3
    if not batched:
        gaussians, cameras = gaussians.batched(), cameras.batched()
        anchor_features = anchor_features[None] if anchor_features is not None else None
    dtype = torch.promote_types(gaussians.means.dtype, torch.float32)
    color = torch.as_tensor(background, dtype=dtype, device=gaussians.means.device).detach()
    check_background(color)
    renderer = RENDERERS[_chosen(backend, dtype, gaussians.means.device, settings)]
    with torch.autocast(gaussians.means.device.type, enabled=False):
        rendering = renderer(
            gaussians.map(lambda v: v.to(dtype) if v.is_floating_point() else v.long()),
            Cameras(cameras.cam_from_world.to(dtype), cameras.intrinsics.to(dtype).detach()),
            height,
            width,
            anchor_features=anchor_features.to(dtype) if anchor_features is not None else None,
            background=color,
            near=near,
            far=far,
            settings=settings,
        )  # fmt: skip
    if batched:
        return rendering
    return rendering.scene(0)


def backends() -> dict[str, str]:
    """Each backend with how it would run here, or with what it lacks; for reports."""
    status = native_status()
    if status.available:
        sets = ", ".join(status.instruction_sets)
        native = f"available ({sets}; {status.threading})"
    else:
        native = f"missing: {status.reason}"
    gsplat = "missing: pip install 'instok3d[gpu]'"
    if gsplat_is_installed():
        gsplat = "available" if torch.cuda.is_available() else "installed, but no CUDA device"
    return {"native": native, "gsplat": gsplat, "reference": "available (slow)"}


def _chosen(
    backend: Backend, dtype: torch.dtype, device: torch.device, settings: RasterSettings
) -> str:
    if backend != "auto":
        if backend == "native" and (device.type != "cpu" or dtype != torch.float32):
            raise ValueError(
                f"the native rasterizer takes float32 on the CPU, got {dtype} on {device}; "
                'use backend="auto"'
            )
        return backend
    if settings.alpha_min < SMALLEST_ALPHA_MIN or dtype != torch.float32:
        return "reference"
    if device.type == "cuda":
        return "gsplat"
    if device.type != "cpu":
        return "reference"
    if native_status().available:
        return "native"
    _warn_of_slow_rendering()
    return "reference"


@cache
def _warn_of_slow_rendering() -> None:
    warnings.warn(
        "rendering takes hundreds of times as long as it could, since the native rasterizer is "
        f"missing: {native_status().reason}",
        stacklevel=4,
    )
