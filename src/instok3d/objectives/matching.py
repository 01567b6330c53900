"""Which predicted group answers for which true instance: one Hungarian match for each scene."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment
from torch import Tensor


@dataclass(frozen=True)
class Matching:
    """Pairs of a group and an instance; no group and no instance occurs twice."""

    groups: Int[Tensor, " pair"]
    instances: Int[Tensor, " pair"]
    """Columns of the cost, in the order of the groups."""


@dataclass(frozen=True)
class Pairs:
    """Which group of a scene answers for which of its instances."""

    groups: Int[Tensor, " pair"]
    ids: Int[Tensor, " pair"]
    """Instance ids, no places."""

    def of(self, ids: Int[Tensor, " instance"]) -> "Pairs":
        """The pairs of these instances alone."""
        kept = torch.isin(self.ids, ids)
        return Pairs(self.groups[kept], self.ids[kept])


def match_groups(cost: Float[Tensor, "group instance"]) -> Matching:
    """The pairs of least total cost: as many as there are instances, or groups if those are fewer.

    Not differentiable: the cost is taken as numbers (Sec. 3.2 matches on detached maps).

    Raises:
        ValueError: A cost is not finite.
    """
    detached = cost.detach().float().cpu()
    if not detached.isfinite().all():
        raise ValueError(
            "the matching cost of groups and instances must be finite, got NaN or infinity: "
            "look for NaN in the rendered group maps"
        )
    groups, instances = linear_sum_assignment(detached.numpy())
    return Matching(
        torch.as_tensor(groups, dtype=torch.long, device=cost.device),
        torch.as_tensor(instances, dtype=torch.long, device=cost.device),
    )
