"""The one call that renders, and the choice of the backend behind it."""

import warnings
from collections.abc import Callable, Sequence
from functools import cache
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.spherical_harmonics import sh_degree
from instok3d.render.gsplat_backend import gsplat_is_installed, render_gsplat
from instok3d.render.native_backend import SMALLEST_ALPHA_MIN, native_status, render_native
from instok3d.render.reference import render_reference
from instok3d.render.settings import RasterSettings
from instok3d.types import Cameras, Gaussians, Rendering

Backend = Literal["auto", "native", "reference", "gsplat"]

MAX_PIXELS = 2**26
"""Of one picture, 8,192 x 8,192: a larger one is taken for a mistake before memory is asked for."""

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
        near: Gaussians whose mean is nearer than this z-depth are not drawn, scene units.
        far: Nor are those farther than this.
        settings: Thresholds.
        backend: "auto" takes gsplat for CUDA tensors, else the native kernels where they are
            built and the tensors are not float64, else the PyTorch reference.

    Raises:
        ValueError: Sizes, devices or types that do not fit together, a picture of more than
            MAX_PIXELS pixels, or an anchor index without a feature row.
    """
    batched = gaussians.means.ndim == 3
    _check(gaussians, cameras, anchor_features, height, width)
    if not batched:
        gaussians, cameras = gaussians.batched(), cameras.batched()
        anchor_features = anchor_features[None] if anchor_features is not None else None
    dtype = torch.promote_types(gaussians.means.dtype, torch.float32)
    renderer = RENDERERS[_chosen(backend, dtype, gaussians.means.device, settings)]
    with torch.autocast(gaussians.means.device.type, enabled=False):
        rendering = renderer(
            gaussians.map(lambda v: v.to(dtype) if v.is_floating_point() else v.long()),
            Cameras(cameras.cam_from_world.to(dtype), cameras.intrinsics.to(dtype).detach()),
            height,
            width,
            anchor_features=anchor_features.to(dtype) if anchor_features is not None else None,
            background=torch.as_tensor(
                background, dtype=dtype, device=gaussians.means.device
            ).detach(),
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


def _check(
    gaussians: Gaussians,
    cameras: Cameras,
    anchor_features: Tensor | None,
    height: int,
    width: int,
) -> None:
    lead = gaussians.means.shape[:-2]
    if len(lead) > 1:
        raise ValueError(
            f"gaussians have {len(lead)} batch axes {tuple(lead)}; render takes 0 or 1"
        )
    if height < 1 or width < 1:
        raise ValueError(f"height and width must be at least 1, got {height} x {width}")
    if height * width > MAX_PIXELS:
        raise ValueError(
            f"a picture of {height} x {width} has more than {MAX_PIXELS} pixels; ask for a "
            "smaller one"
        )
    count = gaussians.means.shape[-2] if gaussians.means.ndim > 1 else 0
    coefficients = gaussians.sh.shape[-2] if gaussians.sh.ndim > 1 else 0
    last = {
        "means": (3,), "quats": (4,), "scales": (3,), "opacities": (),
        "sh": (coefficients, 3), "anchor_index": (),
    }  # fmt: skip
    for name, value in vars(gaussians).items():
        wanted = (*lead, count, *last[name])
        if value.shape != wanted:
            raise ValueError(
                f"gaussians.{name} has the shape {tuple(value.shape)}, wanted {wanted}: with "
                f"means of {tuple(gaussians.means.shape)} the axes before the last must agree"
            )
    sh_degree(gaussians.sh)
    for name, side in (("cam_from_world", 4), ("intrinsics", 3)):
        value = getattr(cameras, name)
        fits = value.ndim == len(lead) + 3 and value.shape[: len(lead)] == lead
        if not fits or value.shape[-2:] != (side, side):
            raise ValueError(
                f"cameras.{name} has the shape {tuple(value.shape)}; with gaussians.means of "
                f"{tuple(gaussians.means.shape)} it must be {tuple(lead)}, a view axis, and "
                f"{side} x {side}"
            )
    if cameras.intrinsics.shape[-3] != cameras.cam_from_world.shape[-3]:
        raise ValueError(
            f"cameras have {cameras.intrinsics.shape[-3]} intrinsics and "
            f"{cameras.cam_from_world.shape[-3]} cam_from_world; both are one for each view"
        )
    if anchor_features is not None and (
        anchor_features.ndim < 2 or anchor_features.shape[:-2] != lead
    ):
        raise ValueError(
            f"anchor_features have the shape {tuple(anchor_features.shape)}; the axes before the "
            f"last two must be {tuple(lead)}, as those of the gaussians"
        )
    tensors = [*vars(gaussians).items(), *vars(cameras).items()]
    if anchor_features is not None:
        tensors.append(("anchor_features", anchor_features))
    for name, value in tensors:
        if value.device != gaussians.means.device:
            raise ValueError(
                f"{name} lies on {value.device}, gaussians.means on {gaussians.means.device}; "
                "bring all tensors to one device"
            )
        if value.is_floating_point() == (name == "anchor_index"):
            raise ValueError(
                f"{name} is {value.dtype}; anchor_index must be whole numbers, all others floats"
            )
