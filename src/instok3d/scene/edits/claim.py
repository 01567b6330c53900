"""What goes with a removed object: Gaussians of others at its rim."""

import torch
from jaxtyping import Int
from torch import Tensor

from instok3d.refinement.assignment import weights_by_region, winning_columns
from instok3d.scene.edits.ownership import row_ids
from instok3d.scene.record import SceneRecord

MIN_SHARE = 0.5
"""Of a Gaussian's visible weight that lies in the pixels of the object."""
MIN_WEIGHT = 0.05
"""Pixels' worth of visible weight below which a Gaussian shows nothing, and stays."""
NEAR_SHARE = 0.25
"""Of the longest side of the object's box: how far outside of the box Gaussians are claimed."""


def claimed_rows(scene: SceneRecord, ids: tuple[int, ...]) -> Int[Tensor, " row"]:
    """Rows of the Gaussians of others that show what is removed more than anything else.

    Haloes: Gaussians beside the object whose visible weight lies, over all input views, by more
    than MIN_SHARE in the pixels that the object wins.

    Args:
        scene: Before the removal.
        ids: Of the objects that are removed.
    """
    if not scene.views or not len(scene.gaussians.means):
        return torch.zeros(0, dtype=torch.long)
    near, far = scene.near_far
    winners = winning_columns(
        scene.gaussians, scene.tokens.assignment, scene.cameras, scene.height, scene.width,
        near=near, far=far,
    )  # fmt: skip
    within = torch.isin(winners, torch.tensor(ids) - 1).long()
    weights = weights_by_region(scene.gaussians, within, 2, scene.cameras, near=near, far=far)
    total, inside = weights.sum(dim=1), weights[:, 1]
    own = torch.isin(row_ids(scene), torch.tensor(ids))
    beside = torch.zeros_like(own)
    for item in scene.objects:
        if item.id in ids:
            margin = NEAR_SHARE * max(item.obb.size)
            low, high = torch.tensor(item.aabb.min) - margin, torch.tensor(item.aabb.max) + margin
            means = scene.gaussians.means
            beside |= ((means >= low) & (means <= high)).all(dim=1)
    claimed = ~own & beside & (total >= MIN_WEIGHT) & (inside > MIN_SHARE * total)
    return claimed.nonzero()[:, 0]
