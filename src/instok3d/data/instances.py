"""Instance id maps: 0 is no instance, -1 is ignored, ids hold across views."""

from jaxtyping import Int
from torch import Tensor


def instance_ids(
    instances: Int[Tensor, "*view height width"], *, min_pixels: int = 1
) -> Int[Tensor, " instance"]:
    """Ids > 0 that cover at least min_pixels over all the maps together, ascending."""
    ids, counts = instances.unique(return_counts=True)
    return ids[(ids > 0) & (counts >= min_pixels)]
