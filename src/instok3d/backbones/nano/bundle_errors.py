"""Residuals of bundle adjustment for every observed point, with their derivatives."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.backbones.nano.bundle_problem import NEAREST, BundleNoise, Observations


@dataclass(frozen=True)
class PointErrors:
    """Whitened, robustly weighted residuals of all points and their derivatives.

    Three residuals per point: reprojection error in x/z and y/z, and the difference between the
    log depths of the point in the two views.
    """

    values: Float[Tensor, "observation point 3"]
    by_twist: Float[Tensor, "observation point 3 6"]
    """By a twist of camera there."""
    by_depth_here: Float[Tensor, "observation point 3"]
    """By the log depth of the point in view here."""
    by_depth_there: Float[Tensor, "observation point 3"]
    """By the log depth of its match in view there."""
    by_focal: Float[Tensor, "observation point 3"]
    """By the log focal length of both cameras."""


def point_errors(
    observations: Observations,
    there_from_here: Float[Tensor, "observation 4 4"],
    correction_here: Float[Tensor, "observation point"],
    correction_there: Float[Tensor, "observation point"],
    log_focal: Float[Tensor, " observation"],
    noise: BundleNoise,
) -> PointErrors:
    """Residuals of all points at the current cameras, depths and focal length.

    Args:
        observations: Points and rays, by the initial depths and focal length.
        there_from_here: Current relative cameras.
        correction_here: Current log-depth correction of each point.
        correction_there: Current log-depth correction at its match.
        log_focal: Logarithm of the current focal length over the initial one.
        noise: Expected errors.
    """
    # 1. Project the points. A longer focal length brings them closer to the optical axis. The
    # projection is compared with the observed rays at the initial focal length, that is in pixels:
    # at the current focal length, increasing it would shrink every error.
    focal = log_focal.exp()[:, None, None]
    points = torch.cat([observations.points[..., :2] / focal, observations.points[..., 2:]], dim=-1)
    points = points * correction_here.exp()[..., None]
    rotated = points @ there_from_here[:, :3, :3].mT
    seen = rotated + there_from_here[:, None, :3, 3]
    front = seen[..., 2] > NEAREST
    z = seen[..., 2].clamp_min(NEAREST)
    u, v, w = seen[..., 0] / z, seen[..., 1] / z, 1 / z
    projected = torch.stack([u, v], dim=-1)
    depth_error = (z / observations.depths.clamp_min(NEAREST)).log() - correction_there
    values = torch.cat([focal * projected - observations.rays, depth_error[..., None]], dim=-1)

    # 2. Derivatives of the three residuals.
    zero = torch.zeros_like(u)
    by_twist = torch.stack(
        [
            focal * torch.stack([w, zero, -u * w, -u * v, 1 + u * u, -v], dim=-1),
            focal * torch.stack([zero, w, -v * w, -1 - v * v, u * v, u], dim=-1),
            torch.stack([zero, zero, w, v, -u, zero], dim=-1),
        ],
        dim=-2,
    )
    parallax = focal * (rotated[..., :2] - projected * rotated[..., 2:]) * w[..., None]
    by_depth_here = torch.cat([parallax, rotated[..., 2:] * w[..., None]], dim=-1)
    inward = -points[..., :2] @ there_from_here[:, :3, :2].mT
    by_focal = focal * (projected + (inward[..., :2] - projected * inward[..., 2:]) * w[..., None])
    by_focal = torch.cat([by_focal, inward[..., 2:] * w[..., None]], dim=-1)
    by_depth_there = torch.zeros_like(by_depth_here)
    by_depth_there[..., 2] = -1 / noise.mutual_depth

    # 3. Whiten the residuals and weight them by confidence and robustly (Cauchy), the ray and the
    # depth apart. Points behind camera there have no weight.
    roots = _ray_roots(observations.precision, parallax, noise.fine_depth)
    values = _whiten(values[..., None], roots, noise)[..., 0]
    share = noise.independence * observations.confidence * front
    of_ray = (share / (1 + values[..., :2].square().sum(-1) / noise.outlier**2)).sqrt()
    of_depth = (share / (1 + values[..., 2].square() / noise.outlier**2)).sqrt()
    weight = torch.stack([of_ray, of_ray, of_depth], dim=-1)
    return PointErrors(
        values * weight,
        _whiten(by_twist, roots, noise) * weight[..., None],
        _whiten(by_depth_here[..., None], roots, noise)[..., 0] * weight,
        by_depth_there * weight,
        _whiten(by_focal[..., None], roots, noise)[..., 0] * weight,
    )


def _ray_roots(
    precision: Float[Tensor, "observation point 2 2"],
    parallax: Float[Tensor, "observation point 2"],
    fine_depth: float,
) -> Float[Tensor, "observation point 3"]:
    """Whitening matrices [[x, xy], [0, y]] of the reprojection errors, as (x, xy, y).

    An error of the depth moves the projection along the parallax. The errors' covariance is
    precision^-1 + fine_depth^2 parallax parallax^T; its inverse by Sherman-Morrison is factorised.
    """
    precise = (precision @ parallax[..., None])[..., 0]
    variance = fine_depth**2
    loss = variance / (1 + variance * (parallax * precise).sum(-1))
    inverse = precision - loss[..., None, None] * precise[..., :, None] * precise[..., None, :]
    x = inverse[..., 0, 0].clamp_min(1e-9).sqrt()
    xy = inverse[..., 0, 1] / x
    y = (inverse[..., 1, 1] - xy.square()).clamp_min(1e-9).sqrt()
    return torch.stack([x, xy, y], dim=-1)


def _whiten(
    rows: Float[Tensor, "observation point 3 column"],
    roots: Float[Tensor, "observation point 3"],
    noise: BundleNoise,
) -> Float[Tensor, "observation point 3 column"]:
    """The three residuals, or their derivatives, in units of their standard deviation."""
    x, y, log_depth = rows.unbind(-2)
    root_x, root_xy, root_y = roots[..., None].unbind(-2)
    return torch.stack(
        [root_x * x + root_xy * y, root_y * y, log_depth / noise.mutual_depth], dim=-2
    )
