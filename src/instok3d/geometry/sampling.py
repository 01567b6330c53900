"""Choosing points that cover a set."""

import torch
from jaxtyping import Float, Int
from torch import Tensor


def farthest_points(
    points: Float[Tensor, "batch point 3"], count: int
) -> Int[Tensor, "batch picked"]:
    """Indices of points that cover each set: the next pick is the farthest from all before it.

    Starts at point 0. No more picks than points, so the indices are distinct as long as the
    points are (the paper's demo repeats point 0 instead, which only adds copies of an anchor).
    Non-finite points are never picked while a finite one is left. Not differentiable.

    Raises:
        ValueError: count is below 1 or there are no points.
    """
    batch, total, _ = points.shape
    if count < 1 or total < 1:
        raise ValueError(f"count and points must be at least 1, got count={count}, points={total}")
    points = points.detach().float()
    finite = points.isfinite().all(dim=-1)
    points = torch.where(finite[..., None], points, torch.zeros_like(points))
    picked = torch.empty(batch, min(count, total), dtype=torch.long, device=points.device)
    # A picked point falls to -1 and a non-finite one to -0.5, so that both lose to any live one,
    # even to an exact copy of a picked point, whose distance is 0.
    distance = torch.full((batch, total), torch.inf, device=points.device)
    distance[~finite] = -0.5
    current = finite.int().argmax(dim=1)
    for step in range(picked.shape[1]):
        picked[:, step] = current
        center = points.gather(1, current[:, None, None].expand(-1, 1, 3))
        distance = torch.minimum(distance, (points - center).square().sum(-1))
        distance.scatter_(1, current[:, None], -1.0)
        current = distance.argmax(dim=1)
    return picked
