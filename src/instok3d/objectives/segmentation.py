"""The grouping loss: BCE and Dice between rendered group maps and instance masks (Eq. 5)."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from instok3d.data.instances import instance_ids
from instok3d.objectives.matching import Pairs, match_groups

EPSILON = 1e-6


@dataclass(frozen=True)
class SegmentationLoss:
    """Means over each scene's matched pairs, 0 for a scene without one, then over the scenes.

    So the loss of a batch is the mean of the losses of its parts, wherever these are computed.
    """

    total: Float[Tensor, ""]
    """bce_weight * bce + dice_weight * dice."""
    bce: Float[Tensor, ""]
    dice: Float[Tensor, ""]
    matched: int
    """Pairs in the batch."""


def segmentation_loss(
    group_maps: Float[Tensor, "batch view group height width"],
    instances: Int[Tensor, "batch view height width"],
    *,
    bce_weight: float = 1.0,
    dice_weight: float = 1.0,
    min_pixels: int = 25,
    ignore_unlabelled: bool = False,
    pairs: Sequence[Pairs] | None = None,
) -> SegmentationLoss:
    """How far the groups' maps are from the instances' masks, after the best match.

    Groups and instances are matched once for each scene, over all its views together, because an
    object is one group in every view. Groups without a partner get no loss.

    Computed in float32. Differentiable in the maps; the match is made on detached ones.

    Args:
        group_maps: Composited probabilities in [0, 1], not divided by alpha, void left out.
        instances: Id maps, the same id for the same object in all views; 0 = no instance,
            -1 = ignore.
        bce_weight: lambda_bce, which the paper does not give.
        dice_weight: lambda_dice, which the paper does not give.
        min_pixels: Instances with fewer pixels over all views are not matched.
        ignore_unlabelled: Leave pixels of no instance out, instead of asking every matched group
            to be absent there (the default: the void is for them).
        pairs: For each scene, the match where it has been made already (on the anchors, see
            `assignment_loss`); instances without a group in it get no loss.
    """
    labelled = instances > 0 if ignore_unlabelled else instances >= 0
    scenes, groups, ids, shares = [], [], [], []
    for scene in range(len(instances)):
        found = instance_ids(instances[scene], min_pixels=min_pixels)
        if len(found) == 0:
            continue
        if pairs is None:
            cost = _matching_cost(
                group_maps[scene], instances[scene], labelled[scene], found, bce_weight, dice_weight
            )
            match = match_groups(cost)
            matched = Pairs(match.groups, found[match.instances])
        else:
            matched = pairs[scene].of(found)
        shares += [1 / (len(matched.ids) * len(instances)) for _ in matched.ids]
        scenes.append(torch.full_like(matched.groups, scene))
        groups.append(matched.groups)
        ids.append(matched.ids)
    if not scenes:
        zero = group_maps.float().sum() * 0.0  # keeps the graph: backward gives zeros
        return SegmentationLoss(zero, zero, zero, 0)
    scene, group, ids = torch.cat(scenes), torch.cat(groups), torch.cat(ids)
    with torch.autocast(group_maps.device.type, enabled=False):
        bce, dice = _pair_losses(
            _probabilities(group_maps[scene, :, group], labelled[scene]).flatten(1),
            (instances[scene] == ids[:, None, None, None]).float().flatten(1),
            labelled[scene].flatten(1).sum(dim=1).clamp_min(1),
            torch.tensor(shares, device=group_maps.device),
        )
    return SegmentationLoss(bce_weight * bce + dice_weight * dice, bce, dice, len(ids))


@torch.no_grad()
def _matching_cost(
    group_maps: Float[Tensor, "view group height width"],
    instances: Int[Tensor, "view height width"],
    labelled: Bool[Tensor, "view height width"],
    ids: Int[Tensor, " instance"],
    bce_weight: float,
    dice_weight: float,
) -> Float[Tensor, "group instance"]:
    """The loss of every group with every instance, as matrix products.

    Because -BCE = g log m + (1 - g) log(1 - m) = g logit(m) + log(1 - m), no tensor of
    [group, instance, pixel] is needed. One view at a time: it stays in the cache.
    """
    shape = (group_maps.shape[1], len(ids))
    log_likelihood = torch.zeros(shape, device=group_maps.device)
    both, map_sums, mask_sums = (torch.zeros_like(log_likelihood) for _ in range(3))
    with torch.autocast(group_maps.device.type, enabled=False):
        for view_maps, view_instances, view_labelled in zip(
            group_maps, instances, labelled, strict=True
        ):
            maps = _probabilities(view_maps, view_labelled).flatten(1)
            masks = (view_instances.flatten()[:, None] == ids).float()
            both += maps @ masks
            map_sums += maps.sum(dim=1, keepdim=True)
            mask_sums += masks.sum(dim=0)
            log_likelihood += torch.logit(maps) @ masks
            log_likelihood += torch.log1p(-maps).sum(dim=1, keepdim=True)
    bce = -log_likelihood / labelled.sum().clamp_min(1)
    return bce_weight * bce + dice_weight * (1 - (2 * both + 1) / (map_sums + mask_sums + 1))


def _probabilities(maps: Float[Tensor, "*any"], labelled: Bool[Tensor, "..."]) -> Tensor:
    """Maps as probabilities whose logarithm is finite, (all but) 0 where no label counts.

    No mask is there either, so such pixels add nothing to any sum.
    """
    maps = maps.float()
    if not labelled.all():
        maps = maps * labelled
    return maps.clamp(EPSILON, 1 - EPSILON)


def _pair_losses(
    maps: Float[Tensor, "pair pixel"],
    masks: Float[Tensor, "pair pixel"],
    pixels: Int[Tensor, " pair"],
    shares: Float[Tensor, " pair"],
) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
    """BCE and Dice over the labelled pixels of all views, summed over pairs by their shares."""
    log_likelihood = (torch.logit(maps) * masks).sum(dim=1) + torch.log1p(-maps).sum(dim=1)
    both = (maps * masks).sum(dim=1)
    dice = 1 - (2 * both + 1) / (maps.sum(dim=1) + masks.sum(dim=1) + 1)
    return (-log_likelihood / pixels * shares).sum(), (dice * shares).sum()
