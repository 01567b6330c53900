"""The rasterizer on CUDA, by gsplat (optional: `pip install 'instok3d[gpu]'`).

gsplat cuts alphas at 0.999 where the other backends cut at 0.99, so that opaque pixels differ by
up to 1 %.
"""

from importlib import import_module
from importlib.util import find_spec

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.spherical_harmonics import sh_degree
from instok3d.render.settings import RasterSettings
from instok3d.types import Cameras, Gaussians, Rendering

CHANNEL_CHUNK = 32
"""Feature channels that gsplat composites at a time."""


def gsplat_is_installed() -> bool:
    """Whether gsplat can be imported; says nothing of a CUDA device."""
    return find_spec("gsplat") is not None


def render_gsplat(
    gaussians: Gaussians,
    cameras: Cameras,
    height: int,
    width: int,
    *,
    anchor_features: Float[Tensor, "batch anchor channel"] | None,
    background: Float[Tensor, " 3"],
    near: float,
    far: float,
    settings: RasterSettings,
) -> Rendering:
    """Pictures of a batch of scenes; the arguments are those of `instok3d.render.render`.

    Raises:
        ModuleNotFoundError: gsplat is not installed.
        ValueError: The tensors are not on a CUDA device, or a threshold other than eps2d is not
            the default: gsplat's are compiled in.
    """
    if settings != RasterSettings(eps2d=settings.eps2d):
        raise ValueError(
            f"gsplat has fixed thresholds and cannot render with {settings}; "
            'use backend="reference"'
        )
    if not gaussians.means.is_cuda:
        raise ValueError(
            f"gsplat needs tensors on a CUDA device, got {gaussians.means.device}; "
            'use backend="auto"'
        )
    try:
        rasterization = import_module("gsplat").rasterization
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "rendering on CUDA needs gsplat: pip install 'instok3d[gpu]'"
        ) from error

    pictures, features = [], []
    for scene in range(gaussians.means.shape[0]):
        means, quats, scales, opacities, sh = _finite_only(gaussians, scene)
        shared = {
            "means": means, "quats": quats, "scales": scales, "opacities": opacities,
            "viewmats": cameras.cam_from_world[scene], "Ks": cameras.intrinsics[scene],
            "width": width, "height": height, "near_plane": near, "far_plane": far,
            "eps2d": settings.eps2d, "packed": False,
        }  # fmt: skip
        degree = sh_degree(sh)
        values, alphas, _ = rasterization(
            colors=sh, sh_degree=degree, render_mode="RGB+ED", **shared
        )
        pictures.append(torch.cat([values, alphas], dim=-1))
        if anchor_features is not None:
            colors = anchor_features[scene][gaussians.anchor_index[scene]]
            maps, _, _ = rasterization(colors=colors, channel_chunk=CHANNEL_CHUNK, **shared)
            features.append(maps)
    picture = torch.stack(pictures).movedim(-1, -3)
    alphas = picture[:, :, 4]
    hit = alphas > 0
    return Rendering(
        colors=picture[:, :, :3] + (1 - alphas)[:, :, None] * background[:, None, None],
        alphas=alphas,
        depths=torch.where(hit, picture[:, :, 3], 0),
        features=torch.stack(features).movedim(-1, -3) if anchor_features is not None else None,
    )


def _finite_only(gaussians: Gaussians, scene: int) -> list[Tensor]:
    """Attributes of one scene, with zeros for Gaussians that have a NaN or an infinity."""
    values = [
        gaussians.means[scene], gaussians.quats[scene], gaussians.scales[scene],
        gaussians.opacities[scene], gaussians.sh[scene],
    ]  # fmt: skip
    count = len(values[0])
    finite = torch.stack([v.reshape(count, -1).isfinite().all(-1) for v in values]).all(0)
    return [torch.where(finite.view(-1, *[1] * (v.ndim - 1)), v, 0) for v in values]
