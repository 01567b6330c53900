"""What goes with a removed object: Gaussians of others at its rim."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from instok3d.refinement.assignment import weights_by_region, winning_columns
from instok3d.scene.edits.ownership import drawn_rows, row_ids
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
    than MIN_SHARE in the pixels that the object wins. Views are drawn without the hidden objects,
    but with what is removed: hidden Gaussians hide nothing, show nothing, and stay.

    Args:
        scene: Before the removal.
        ids: Of the objects that are removed.
    """
    if not scene.views or not len(scene.gaussians.means):
        return torch.zeros(0, dtype=torch.long)
    near, far = scene.near_far
    removed = torch.tensor(ids)
    own = torch.isin(row_ids(scene), removed)
    shown = drawn_rows(scene) | own
    gaussians = scene.gaussians.rows(shown)
    winners = winning_columns(
        gaussians, scene.tokens.assignment, scene.cameras, scene.height, scene.width,
        near=near, far=far,
    )  # fmt: skip
    within = torch.isin(winners, removed - 1).long()
    weights = weights_by_region(gaussians, within, 2, scene.cameras, near=near, far=far)
    total, inside = weights.sum(dim=1), weights[:, 1]
    claimed = (total >= MIN_WEIGHT) & (inside > MIN_SHARE * total)
    claimed &= ~own[shown] & _beside(scene, ids, gaussians.means)
    return shown.nonzero()[claimed, 0]


def _beside(
    scene: SceneRecord, ids: tuple[int, ...], points: Float[Tensor, "point 3"]
) -> Bool[Tensor, " point"]:
    """Which points lie in the box of one of the objects, or near it."""
    beside = torch.zeros(len(points), dtype=torch.bool)
    for item in scene.objects:
        if item.id in ids:
            margin = NEAR_SHARE * max(item.obb.size)
            low, high = torch.tensor(item.aabb.min) - margin, torch.tensor(item.aabb.max) + margin
            beside |= ((points >= low) & (points <= high)).all(dim=1)
    return beside
