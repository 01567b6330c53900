"""The assignment loss: anchors are supervised by the instances of the pixels they come from.

Not in the paper, which supervises rendered maps alone. A rendered map says little to a group whose
anchors lie a few pixels off, as they do with predicted geometry, and groups without a partner may
take anchors from those that have one at no cost. Here every anchor answers for its own patch.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.data.instances import instance_ids
from instok3d.objectives.matching import Pairs, match_groups

TINY = 1e-12


@dataclass(frozen=True)
class AssignmentLoss:
    """Means over the scenes; a scene without a labelled anchor counts 0."""

    total: Float[Tensor, ""]
    """cross_entropy_weight * cross_entropy + dice_weight * dice."""
    cross_entropy: Float[Tensor, ""]
    dice: Float[Tensor, ""]
    pairs: tuple[Pairs, ...]
    """For each scene, which group answers for which instance."""


def assignment_loss(
    assignment: Float[Tensor, "batch anchor column"],
    instances: Int[Tensor, "batch anchor pixel"],
    *,
    cross_entropy_weight: float = 0.2,
    dice_weight: float = 1.0,
    min_pixels: int = 25,
    ignore_unlabelled: bool = False,
) -> AssignmentLoss:
    """How far the anchors' groups are from the instances in their patches, after the best match.

    An anchor should belong to the groups of the instances in its patch by their shares of it, and
    to the void by the share of no instance. Cross-entropy asks that of each anchor; Dice of each
    instance, so that small ones count as much as walls. Groups with and without a partner are
    held off what belongs to another one.

    Differentiable in the assignment; the match is made on detached numbers.

    Args:
        assignment: pi (Eq. 3), float32; the last column is the void.
        instances: Id of each pixel of each anchor's patch; 0 = no instance, -1 = ignore.
        cross_entropy_weight: Of the mean over labelled pixels.
        dice_weight: Of the mean over instances.
        min_pixels: Instances with fewer pixels are not matched; their pixels are ignored.
        ignore_unlabelled: Ignore pixels of no instance, instead of giving them to the void.
    """
    if ignore_unlabelled:
        instances = instances.masked_fill(instances == 0, -1)
    cross_entropies, dices, pairs = [], [], []
    for pi, ids in zip(assignment, instances, strict=True):
        cross_entropy, dice, found = _scene_loss(
            pi, ids, min_pixels, weights=(cross_entropy_weight, dice_weight)
        )
        cross_entropies.append(cross_entropy)
        dices.append(dice)
        pairs.append(found)
    cross_entropy, dice = torch.stack(cross_entropies).mean(), torch.stack(dices).mean()
    total = cross_entropy_weight * cross_entropy + dice_weight * dice
    return AssignmentLoss(total, cross_entropy, dice, tuple(pairs))


def _scene_loss(
    pi: Float[Tensor, "anchor column"],
    instances: Int[Tensor, "anchor pixel"],
    min_pixels: int,
    *,
    weights: Sequence[float],
) -> tuple[Float[Tensor, ""], Float[Tensor, ""], Pairs]:
    found = instance_ids(instances, min_pixels=min_pixels)
    masks = (instances[..., None] == found).sum(dim=1).to(pi.dtype)  # anchor instance, in pixels
    void = (instances == 0).sum(dim=1).to(pi.dtype)
    each = masks.sum(dim=1) + void  # labelled pixels of each anchor
    log_pi = pi.clamp_min(TINY).log()
    labelled = each.sum().clamp_min(1)
    with torch.no_grad():
        cross_entropy = -(log_pi[:, :-1].T @ masks) / labelled
        both = pi[:, :-1].T @ masks
        dice = _dice(both, (pi[:, :-1].T @ each)[:, None], masks.sum(dim=0))
        match = match_groups(weights[0] * cross_entropy + weights[1] * dice)
    group, masks = match.groups, masks[:, match.instances]
    cross_entropy = -((log_pi[:, group] * masks).sum() + (log_pi[:, -1] * void).sum()) / labelled
    mine = pi[:, group]
    dice = _dice((mine * masks).sum(dim=0), each @ mine, masks.sum(dim=0))
    # The sum of nothing is 0 and keeps the graph.
    return cross_entropy, dice.sum() / max(len(group), 1), Pairs(group, found[match.instances])


def _dice(both: Tensor, predicted: Tensor, true: Tensor) -> Tensor:
    """1 - Dice, in pixels, with the same 1 above and below as for rendered maps (Eq. 5)."""
    return 1 - (2 * both + 1) / (predicted + true + 1)
