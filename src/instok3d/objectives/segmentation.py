"""The grouping loss: BCE and Dice between rendered group maps and instance masks (Eq. 5)."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from instok3d.objectives.matching import match_groups

EPSILON = 1e-6


@dataclass(frozen=True)
class SegmentationLoss:
    """Means over all matched pairs of the batch; 0 where nothing was matched."""

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
    """
    with torch.autocast(group_maps.device.type, enabled=False):
        bce, dice = [], []
        for scene_maps, scene_instances in zip(group_maps, instances, strict=True):
            maps = scene_maps.float().transpose(0, 1).flatten(1)
            masks, valid = _masks(scene_instances, min_pixels, ignore_unlabelled)
            if masks.shape[1] == 0:
                continue
            scene_bce, scene_dice = _matched_losses(maps, masks, valid, bce_weight, dice_weight)
            bce.append(scene_bce)
            dice.append(scene_dice)
        if not bce:
            zero = group_maps.float().sum() * 0.0  # keeps the graph: backward gives zeros
            return SegmentationLoss(zero, zero, zero, 0)
        all_bce, all_dice = torch.cat(bce), torch.cat(dice)
        mean_bce, mean_dice = all_bce.mean(), all_dice.mean()
        return SegmentationLoss(
            bce_weight * mean_bce + dice_weight * mean_dice, mean_bce, mean_dice, len(all_bce)
        )


def _masks(
    instances: Int[Tensor, "view height width"], min_pixels: int, ignore_unlabelled: bool
) -> tuple[Float[Tensor, "pixel instance"], Bool[Tensor, " pixel"]]:
    flat = instances.flatten()
    ids, counts = flat.unique(return_counts=True)
    ids = ids[(ids > 0) & (counts >= max(min_pixels, 1))]
    valid = flat > 0 if ignore_unlabelled else flat >= 0
    return (flat[:, None] == ids).float(), valid


def _matched_losses(
    maps: Float[Tensor, "group pixel"],
    masks: Float[Tensor, "pixel instance"],
    valid: Bool[Tensor, " pixel"],
    bce_weight: float,
    dice_weight: float,
) -> tuple[Float[Tensor, " pair"], Float[Tensor, " pair"]]:
    with torch.no_grad():
        bce, dice = _all_pairs(maps, masks, valid)
        match = match_groups(bce_weight * bce + dice_weight * dice)
    # Again with gradients, for the matched groups alone: a quarter of them or so.
    bce, dice = _all_pairs(maps[match.groups], masks[:, match.instances], valid)
    return bce.diagonal(), dice.diagonal()


def _all_pairs(
    maps: Float[Tensor, "group pixel"],
    masks: Float[Tensor, "pixel instance"],
    valid: Bool[Tensor, " pixel"],
) -> tuple[Float[Tensor, "group instance"], Float[Tensor, "group instance"]]:
    """BCE and Dice of every group with every instance, as matrix products.

    -BCE = g log m + (1 - g) log(1 - m) = g logit(m) + log(1 - m), so no [group, instance, pixel]
    tensor is needed.
    """
    if not valid.all():
        maps, masks = maps[:, valid], masks[valid]
    pixels = maps.shape[1]
    maps = maps.clamp(EPSILON, 1 - EPSILON)
    absent = torch.log1p(-maps)
    bce = -((maps.log() - absent) @ masks + absent.sum(dim=1, keepdim=True)) / pixels
    both = maps @ masks
    dice = 1 - (2 * both + 1) / (maps.sum(dim=1, keepdim=True) + masks.sum(dim=0) + 1)
    return bce, dice
