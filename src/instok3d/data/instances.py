"""Instance id maps and masks: 0 is no instance, -1 is ignored, ids hold across views."""

import torch
from jaxtyping import Bool, Int
from torch import Tensor


def instance_ids(
    instances: Int[Tensor, "*view height width"], *, min_pixels: int = 1
) -> Int[Tensor, " instance"]:
    """Ids > 0 that cover at least min_pixels over all the maps together, ascending."""
    ids, counts = instances.unique(return_counts=True)
    return ids[(ids > 0) & (counts >= min_pixels)]


def instance_masks(
    instances: Int[Tensor, "*view height width"], ids: Int[Tensor, " instance"]
) -> Bool[Tensor, "instance *view height width"]:
    """One mask for each of the ids."""
    return instances[None] == ids.view(-1, *([1] * instances.ndim))


def masks_to_ids(
    masks: Bool[Tensor, "instance *view height width"],
) -> Int[Tensor, "*view height width"]:
    """Id n+1 where mask n is true, 0 where none is; the first of overlapping masks wins."""
    if masks.shape[0] == 0:
        return torch.zeros(masks.shape[1:], dtype=torch.long, device=masks.device)
    first = masks.int().argmax(dim=0)
    return torch.where(masks.any(dim=0), first + 1, torch.zeros_like(first))


def ignore_small(
    instances: Int[Tensor, "*view height width"], *, min_pixels: int
) -> Int[Tensor, "*view height width"]:
    """The maps with instances of fewer than min_pixels (over all maps) set to -1."""
    ids, counts = instances.unique(return_counts=True)
    small = ids[(ids > 0) & (counts < min_pixels)]
    return torch.where(torch.isin(instances, small), torch.full_like(instances, -1), instances)


def relabel(instances: Int[Tensor, "*view height width"]) -> Int[Tensor, "*view height width"]:
    """The same maps with ids 1, 2, ... without holes, in the order of the old ids."""
    ids = instance_ids(instances)
    new = torch.searchsorted(ids, instances.clamp_min(0)) + 1
    return torch.where(instances > 0, new, instances)
