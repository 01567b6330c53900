"""The Gaussians of one scene, optimised until they give the photos that the scene was made from."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid
from instok3d.refinement.exposure import Exposure
from instok3d.refinement.optimized import OptimizedGaussians
from instok3d.refinement.settings import RefinementSettings
from instok3d.refinement.supervision import Supervision, level_of_step, pyramid, turns
from instok3d.render import render
from instok3d.types import Cameras, Gaussians

TOLD_EVERY = 10
"""Steps between two reports of progress."""


@dataclass(frozen=True)
class Refined:
    """What the optimisation gives."""

    gaussians: Gaussians
    """As many and in the order of those that came in, unless some were split."""
    steps: int
    """That were done; fewer than asked for where it was stopped."""
    psnr_before: float
    """Of the renders at the photos' cameras, dB, exposure not fitted."""
    psnr_after: float
    """Likewise, with the exposure that was fitted to each photo."""


@dataclass(frozen=True)
class Progress:
    """How far the optimisation is."""

    step: int
    steps: int
    psnr: float
    """Of the last step's views at the size it saw, dB."""


@torch.enable_grad()
def refine_gaussians(
    gaussians: Gaussians,
    cameras: Cameras,
    photos: Float[Tensor, "view 3 height width"],
    settings: RefinementSettings = RefinementSettings(),  # noqa: B008 - frozen
    *,
    known: Bool[Tensor, "view _ _"] | None = None,
    near: float,
    far: float,
    progress: Callable[[Progress], None] | None = None,
    stop: Callable[[], bool] | None = None,
) -> Refined:
    """Optimise Gaussians on the photos alone: Adam on the L1 difference. Not differentiable.

    1. The photos are looked at from coarse to fine, some views at a time.
    2. Renders are exposed as each photo was, so that light that differs between photos does not
       end up in the colours of the surfaces.
    3. A weak pull of the centres to where they began keeps Gaussians at their object.
    4. Half-way the Gaussians with the largest gradients are split, if `settings` ask for it.

    Cameras stay as they are: moving them too gave nothing on real photos. Anchors keep their
    Gaussians. Same input, seed and number of threads give the same bits.

    Args:
        gaussians: One scene, unbatched.
        cameras: Of the photos, unbatched, in the scene's world.
        photos: sRGB in [0, 1].
        settings: How long, and with what.
        known: Pixels that count, of the photos' height and width; None counts all.
        near: Gaussians nearer than this z-depth are not drawn, scene units.
        far: Nor are those farther than this.
        progress: Called every TOLD_EVERY steps and after the last.
        stop: Asked before every step; True ends the optimisation there.

    Raises:
        ValueError: Sizes that do not fit together, or no pixel counts.
    """
    full = Supervision.of(photos.float(), cameras.map(Tensor.float), known)
    before = _psnr(gaussians, full, None, near, far)
    if settings.steps == 0 or not len(gaussians.means):
        return Refined(gaussians, 0, before, before)
    levels = pyramid(full, coarse_side=settings.coarse_side)
    optimized = OptimizedGaussians(
        gaussians, settings.rates, length=typical_distance(gaussians, cameras)
    )
    exposure = None
    if settings.exposure and len(photos) > 1:
        exposure = Exposure(len(photos), rate=settings.rates.exposure, device=photos.device)
    turn = turns(len(photos), settings.views_per_step, seed=settings.seed)
    split_at = settings.steps // 2 if settings.split_share > 0 else -1
    done = 0
    for step in range(settings.steps):
        if stop is not None and stop():
            break
        if step == split_at:
            optimized.split(settings.split_share)
        indices = next(turn)
        level = level_of_step(step, settings.steps, len(levels), settings.coarse_share)
        seen = levels[level].views(indices)
        difference = _renders(optimized.gaussians(), seen, exposure, indices, near, far)
        difference = difference - seen.photos
        loss = _mean_of_known(difference.abs(), seen.weights)
        (loss + settings.mean_pull * optimized.pull()).backward()
        optimized.step()
        if exposure is not None:
            exposure.step()
        done = step + 1
        if progress is not None and (done % TOLD_EVERY == 0 or done == settings.steps):
            error = _mean_of_known(difference.detach().square(), seen.weights)
            progress(Progress(done, settings.steps, _decibels(error)))
    refined = optimized.gaussians().map(Tensor.detach)
    return Refined(refined, done, before, _psnr(refined, full, exposure, near, far))


def typical_distance(gaussians: Gaussians, cameras: Cameras) -> float:
    """Median distance of the Gaussians from the first camera, scene units; 1 where it is 0."""
    if not len(gaussians.means):
        return 1.0
    center = invert_rigid(cameras.cam_from_world[0])[:3, 3].to(gaussians.means)
    return float((gaussians.means - center).norm(dim=1).median()) or 1.0


@torch.no_grad()
def _psnr(
    gaussians: Gaussians, full: Supervision, exposure: Exposure | None, near: float, far: float
) -> float:
    """Of all views and known pixels together."""
    errors = []
    for view in range(len(full.photos)):
        seen = full.views([view])
        renders = _renders(gaussians, seen, exposure, [view], near, far)
        error = (renders.clamp(0, 1) - seen.photos).square()
        errors.append(_mean_of_known(error, seen.weights))
    return _decibels(torch.stack(errors).mean())


def _renders(
    gaussians: Gaussians,
    seen: Supervision,
    exposure: Exposure | None,
    views: list[int],
    near: float,
    far: float,
) -> Float[Tensor, "view 3 height width"]:
    """At the cameras of some views, exposed as their photos were."""
    height, width = seen.photos.shape[-2:]
    renders = render(gaussians, seen.cameras, height, width, near=near, far=far).colors
    return renders if exposure is None else exposure.applied(renders, views)


def _mean_of_known(
    values: Float[Tensor, "view 3 height width"],
    weights: Float[Tensor, "view 1 height width"] | None,
) -> Float[Tensor, ""]:
    if weights is None:
        return values.mean()
    return (values * weights).sum() / (3 * weights.sum()).clamp_min(1e-6)


def _decibels(squared_error: Tensor) -> float:
    return float(-10 * squared_error.clamp_min(1e-10).log10())
