"""Choosing which photos to use when there are more than the model takes."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from instok3d.geometry.cameras import invert_rigid


def choose_views(descriptors: Float[Tensor, "view channel"], count: int) -> list[int]:
    """Indices of `count` views that cover all of them, in their first order, view 0 among them.

    Farthest-point choice: the next view is the one least like all views chosen before it (the
    earliest of equals), so that copies come last. Deterministic; not differentiable.

    Raises:
        ValueError: count is below 1, or a descriptor is not finite.
    """
    if count < 1:
        raise ValueError(f"at least one view must be chosen, got count={count}")
    if not descriptors.isfinite().all():
        raise ValueError("the descriptors of views must be finite")
    total = descriptors.shape[0]
    if count >= total:
        return list(range(total))
    points = descriptors.double()
    chosen = [0]
    distance = torch.full((total,), torch.inf, dtype=torch.float64)
    while len(chosen) < count:
        distance = torch.minimum(distance, (points - points[chosen[-1]]).square().sum(-1))
        distance[chosen] = -1.0
        chosen.append(int(distance.argmax()))
    return sorted(chosen)


def describe_pictures(
    thumbnails: Float[Tensor, "view 3 side side"],
) -> Float[Tensor, "view channel"]:
    """What small pictures look like: their colours and their brightness gradients.

    Each picture's brightness is normalised first, so that a change of exposure counts little.
    """
    mean = thumbnails.mean(dim=(1, 2, 3), keepdim=True)
    spread = thumbnails.std(dim=(1, 2, 3), keepdim=True, correction=0)
    colors = functional.avg_pool2d((thumbnails - mean) / (spread + 0.1), 2)
    brightness = ((thumbnails - mean) / (spread + 0.1)).mean(dim=1)
    along_x = brightness[:, :, 1:] - brightness[:, :, :-1]
    along_y = brightness[:, 1:, :] - brightness[:, :-1, :]
    return torch.cat([colors.flatten(1), along_x.flatten(1), along_y.flatten(1)], dim=1)


def describe_cameras(cam_from_world: Float[Tensor, "view 4 4"]) -> Float[Tensor, "view 6"]:
    """Where cameras stand and look: centres in units of their spread, and viewing directions."""
    world_from_cam = invert_rigid(cam_from_world)
    centers = world_from_cam[:, :3, 3]
    centers = centers - centers.mean(dim=0)
    spread = centers.norm(dim=1).mean()
    centers = centers / torch.where(spread > 1e-9, spread, torch.ones_like(spread))
    return torch.cat([centers, world_from_cam[:, :3, 2]], dim=1)
