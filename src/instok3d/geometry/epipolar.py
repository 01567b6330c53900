"""Epipolar error of matches that also rejects points behind a camera."""

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid

BEHIND_PX = 1e4
"""Error of a match that no point in front of both cameras explains."""


def match_errors(
    pixels_a: Float[Tensor, "point 2"],
    pixels_b: Float[Tensor, "point 2"],
    b_from_a: Float[Tensor, "*batch 4 4"],
    intrinsics_a: Float[Tensor, "3 3"],
    intrinsics_b: Float[Tensor, "3 3"],
) -> Float[Tensor, "*batch point"]:
    """Distance of each match from the epipolar half-line, pixels; the larger of both directions.

    A point at a pixel of a has any depth > 0, so b sees it on half of the epipolar line, between
    the projection of the ray's direction (infinite depth) and the epipole (depth 0). Unlike the
    distance from the whole line this tells a translation from its opposite.
    """
    there = _one_way(pixels_a, pixels_b, b_from_a, intrinsics_a, intrinsics_b)
    back = _one_way(pixels_b, pixels_a, invert_rigid(b_from_a), intrinsics_b, intrinsics_a)
    return torch.maximum(there, back)


def _one_way(
    pixels_a: Tensor, pixels_b: Tensor, b_from_a: Tensor, intrinsics_a: Tensor, intrinsics_b: Tensor
) -> Tensor:
    one = torch.ones_like(pixels_a[:, :1])
    rays_a = torch.cat([pixels_a, one], dim=1) @ intrinsics_a.inverse().mT
    rays_b = torch.cat([pixels_b, one], dim=1) @ intrinsics_b.inverse().mT
    # 1. Up to scale, the point in b's frame is far + w * step with an inverse depth w >= 0.
    far = rays_a @ b_from_a[..., :3, :3].mT
    step = torch.nn.functional.normalize(b_from_a[..., None, :3, 3], dim=-1).expand_as(far)
    # 2. w with the least |(far + w step) x ray|, ray being that of the match. It is 0 if both
    #    cameras stand at one place, where step is 0.
    across_far = torch.linalg.cross(far, rays_b.expand_as(far))
    across_step = torch.linalg.cross(step, rays_b.expand_as(far))
    length = across_step.square().sum(-1).clamp_min(1e-12)
    inverse_depth = (-(across_far * across_step).sum(-1) / length).clamp_min(0)
    near = far + inverse_depth[..., None] * step
    # 3. The smaller error of this point and of the infinitely far one.
    return torch.minimum(*(_pixel_distance(each, pixels_b, intrinsics_b) for each in (far, near)))


def _pixel_distance(points: Tensor, pixels: Tensor, intrinsics: Tensor) -> Tensor:
    seen = points @ intrinsics.mT
    in_front = points[..., 2] > 1e-3 * points.norm(dim=-1)
    distance = (seen[..., :2] / seen[..., 2:].clamp_min(1e-9) - pixels).norm(dim=-1)
    return torch.where(in_front, distance, BEHIND_PX)
