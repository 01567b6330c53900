"""The instances of the shown masks as columns: 0, 1, 2, ... in the order of ids, the void last."""

from dataclasses import dataclass

import torch
from jaxtyping import Int
from torch import Tensor

from instok3d.data.instances import instance_ids
from instok3d.evaluation.methods import Shown


@dataclass(frozen=True)
class Instances:
    """Which ids there are, and where."""

    ids: Int[Tensor, " instance"]
    """Ascending."""
    columns: Int[Tensor, "view height width"]
    """Of each pixel; the number of ids where no thing is known."""

    @property
    def num_columns(self) -> int:
        """Instances and the void."""
        return len(self.ids) + 1

    def column_of(self, ids: Int[Tensor, "*any"]) -> Int[Tensor, "*any"]:
        """The column of each id; the void's for what is no id of these."""
        if not len(self.ids):
            return torch.zeros_like(ids)
        place = torch.searchsorted(self.ids, ids).clamp_max(len(self.ids) - 1)
        return torch.where(self.ids[place] == ids, place, len(self.ids))


def instances_of(shown: Shown) -> Instances:
    """Those of the masks that are shown.

    Raises:
        ValueError: No masks are.
    """
    if shown.masks is None:
        raise ValueError("the masks of the context views are not shown; need 'masks'")
    ids = instance_ids(shown.masks)
    return Instances(ids, Instances(ids, shown.masks).column_of(shown.masks))
