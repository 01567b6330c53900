"""Bundle adjustment of cameras and coarse depth from observations between views.

Depth is predicted, and the errors of neighbouring pixels correlate. Therefore not every point is an
unknown: each view has a coarse grid of log-depth corrections, with a prior as strong as predicted
depth is usually accurate.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.backbones.nano.bundle_equations import (
    NormalEquations,
    native_equations,
    normal_equations,
)
from instok3d.backbones.nano.bundle_problem import (
    NEAREST,
    BundleNoise,
    Observations,
    SolveSettings,
    confidence_weight,
)
from instok3d.backbones.nano.depth_grid import node_weights, prior_precision
from instok3d.backbones.nano.native_kernels import kernels_for
from instok3d.geometry.cameras import invert_rigid
from instok3d.geometry.registration import rigid_from_twist

MOST_LOG_FOCAL = 0.75
"""Limit of the logarithm of the focal length over its first estimate. From a field of view of 60
degrees, those of 40 and 95 degrees are .46 and .64 away."""


@torch.no_grad()
def adjust_bundle(
    observations: Observations,
    cam_from_first: Float[Tensor, "batch view 4 4"],
    settings: SolveSettings,
    grid: tuple[int, int],
    *,
    log_focal: Float[Tensor, " batch"] | None = None,
    iterations: int = 6,
) -> tuple[
    Float[Tensor, "batch view 4 4"], Float[Tensor, "batch view node"], Float[Tensor, " batch"]
]:
    """Refined cameras, log-depth corrections at the nodes, and log focal length.

    Gauss-Newton on three kinds of residuals: reprojection errors and differences of log depth
    between two views (both Cauchy), and the prior of the depth corrections. Reprojection errors
    count less along the parallax, where an error of depth explains them. The first camera is fixed;
    the prior fixes the scale. Not differentiable.

    Args:
        observations: In the units of the cameras.
        cam_from_first: Initial cameras.
        settings: What is solved for, and the expected errors.
        grid: Rows and columns of nodes.
        log_focal: Initial logarithm of the focal length over that of the observations; None: 0.
            Does not change where the focal length is known.
        iterations: Gauss-Newton steps.
    """
    batch, count = cam_from_first.shape[:2]
    nodes, noise = grid[0] * grid[1], settings.noise
    cameras, corrections = cam_from_first, cam_from_first.new_zeros(batch, count, nodes)
    log_focal = cam_from_first.new_zeros(batch) if log_focal is None else log_focal
    if count < 2 or not len(observations.scenes):
        return cameras, corrections, log_focal
    # 1. Weights by confidence. Pairs that contradict the initial cameras lose theirs.
    agreeing = _agreement_weights(observations, cameras, log_focal, noise.agreement)
    observations = replace(observations, confidence=agreeing)
    # 2. Prior of the corrections. Known depth has a thousandth of the standard deviation.
    prior = prior_precision(
        grid, deviation=noise.depth, correlation_length=noise.depth_correlation_length
    ).to(corrections)
    stiffness = torch.where(settings.depth_is_free > 0, 1.0, 1e6)[..., None, None] * prior
    views = torch.arange(count, device=corrections.device)
    equations_at = _equations_of(observations, grid, noise)
    for _ in range(iterations):
        # 3. Normal equations of the observations and of the priors.
        equations = equations_at(cameras, corrections, log_focal)
        equations.hessian[:, views, views, 6:, 6:] += stiffness
        equations.gradient[..., 6:] += (stiffness @ corrections[..., None])[..., 0]
        focal_precision = 1 / (noise.focal**2 + log_focal.square())
        equations.focal_hessian.add_(focal_precision)
        equations.focal_gradient.add_(focal_precision * log_focal)
        # 4. Step, limited to where the linearisation holds.
        step, focal_step = _solve(equations, focal_is_free=settings.focal_is_free)
        cameras = rigid_from_twist(step[..., :6]) @ cameras
        corrections = (corrections + step[..., 6:]).clamp(-0.7, 0.7)
        log_focal = (log_focal + focal_step.clamp(-0.1, 0.1)).clamp(-MOST_LOG_FOCAL, MOST_LOG_FOCAL)
    return cameras, corrections, log_focal


def _equations_of(
    observations: Observations, grid: tuple[int, int], noise: BundleNoise
) -> Callable[[Tensor, Tensor, Tensor], NormalEquations]:
    """Normal equations as a function of cameras, corrections and log focal length."""
    if kernels_for(observations.points) is not None:
        return partial(native_equations, observations, grid, noise)
    here = node_weights(observations.positions_here, grid)
    there = node_weights(observations.positions_there, grid)
    return partial(normal_equations, observations, here, there, noise)


def _agreement_weights(
    observations: Observations,
    cameras: Float[Tensor, "batch view 4 4"],
    log_focal: Float[Tensor, " batch"],
    agreement: float,
) -> Float[Tensor, "observation point"]:
    """Confidence weights of all matches, reduced for pairs that contradict the initial cameras.

    Views of different places that look alike have many confident but wrong matches. Those lie far
    from the projections under the initial cameras, which come from better pairs. A pair has its
    full weight where 80 % of its matches agree with the cameras, and none at 50 %.
    """
    weight = confidence_weight(observations.confidence)
    there, here = (
        cameras[observations.scenes, view] for view in (observations.there, observations.here)
    )
    there_from_here = there @ invert_rigid(here)
    focal = log_focal[observations.scenes].exp()[:, None, None]
    points = torch.cat([observations.points[..., :2] / focal, observations.points[..., 2:]], dim=-1)
    seen = points @ there_from_here[:, :3, :3].mT + there_from_here[:, None, :3, 3]
    projected = focal * seen[..., :2] / seen[..., 2:].clamp_min(NEAREST)
    error = (projected - observations.rays).norm(dim=-1)
    agrees = (error < agreement) & (seen[..., 2] > NEAREST)
    share = (weight * agrees).sum(-1) / weight.sum(-1).clamp_min(1e-9)
    return weight * ((share - 0.5) / 0.3).clamp(0, 1)[:, None]


def _solve(
    equations: NormalEquations, *, focal_is_free: bool
) -> tuple[Float[Tensor, "batch view part"], Float[Tensor, " batch"]]:
    """Gauss-Newton step of all views and log-focal update; the first camera does not move."""
    hessian, gradient = equations.hessian, equations.gradient
    batch, count, _, size, _ = hessian.shape
    # 1. One matrix over the unknowns of all views, in float64.
    whole = hessian.permute(0, 1, 3, 2, 4).reshape(batch, count * size, count * size).double()
    # 2. Damp the twists: few matches may leave a camera underdetermined.
    is_twist = torch.arange(count * size, device=hessian.device) % size < 6
    diagonal = whole.diagonal(dim1=-2, dim2=-1)
    diagonal += 1e-4 * diagonal[:, is_twist].mean(-1, keepdim=True).clamp_min(1e-6) * is_twist
    # 3. Remove the first camera, whose twist stands first, and append the log focal length. Where
    # that is known, its cross terms and gradient are zero.
    cross = equations.focal_cross.flatten(1).double()[:, 6:, None] * focal_is_free
    own = equations.focal_hessian.double()[:, None, None]
    rows = (torch.cat([whole[:, 6:, 6:], cross], 2), torch.cat([cross.mT, own], 2))
    whole = torch.cat(rows, dim=1)
    right = gradient.flatten(1).double()[:, 6:, None]
    focal_gradient = equations.focal_gradient.double()[:, None, None] * focal_is_free
    # 4. Cholesky: the priors make the matrix positive definite.
    found = -torch.cholesky_solve(
        torch.cat([right, focal_gradient], 1), torch.linalg.cholesky(whole)
    )
    step = gradient.new_zeros(batch, count * size)
    step[:, 6:] = found[:, :-1, 0].to(step)
    step = step.view(batch, count, size)
    # 5. Shorten steps of more than half a radian or half a unit: a sign of too few matches.
    longest = step[..., :6].norm(dim=-1).amax(dim=1).clamp_min(1e-9)
    return step * (0.5 / longest).clamp_max(1.0)[:, None, None], found[:, -1, 0].to(step)
