"""Class-agnostic average precision of instance masks, as COCO measures it, with one class.

The rules, which stand beside every figure: one mask a group and image, from the argmax of the
rendered group maps; confidence = mean of the group's map over its mask; a mask may match only
instances of its own image; greedy in the order of confidence; 101-point interpolation.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from torch import Tensor

IOU_THRESHOLDS = (0.25, *(k / 100 for k in range(50, 100, 5)))
"""0.25 for AP25, then .50:.05:.95 for AP."""


@dataclass(frozen=True)
class ApSettings:
    """What counts as an instance and as a prediction."""

    min_instance_area: int = 0
    """Instances of fewer pixels are neither demanded nor counted against a prediction."""
    min_predicted_area: int = 10
    """Predicted masks of fewer pixels are dropped."""
    void: Literal["ignore", "count"] = "ignore"
    """Pixels of no instance (id 0): 'ignore' takes them out of the predicted masks before the
    overlap is measured, since they are not annotated; 'count' leaves them in as background.
    Pixels with id -1 are always taken out."""


@dataclass(frozen=True)
class PredictedMasks:
    """Masks of one image that do not overlap."""

    ids: Int[np.ndarray, "height width"]
    """Group of each pixel; -1 for no group."""
    scores: Float[np.ndarray, " group"]
    """Confidence of each group."""


@dataclass(frozen=True)
class ImageMatches:
    """What the predictions of one image met, at every one of IOU_THRESHOLDS."""

    scores: Float[np.ndarray, " mask"]
    areas: Int[np.ndarray, " mask"]
    true_positive: Bool[np.ndarray, "threshold mask"]
    ignored: Bool[np.ndarray, "threshold mask"]
    """Neither right nor wrong: unmatched, and half or more of it lies where nothing is asked."""
    num_instances: int


@dataclass(frozen=True)
class InstanceAp:
    """Average precision in [0, 1], pooled over images; NaN where there was no instance."""

    ap: float
    """Mean over the IoU thresholds .50:.05:.95."""
    ap50: float
    ap25: float
    num_instances: int
    num_masks: int
    ap_scannet: float = np.nan
    """Mean over .50:.05:.90, the thresholds of ScanNet's benchmark."""


def predicted_masks(
    group_maps: Float[Tensor, "group height width"],
    alphas: Float[Tensor, "height width"],
    *,
    alpha_min: float = 0.0,
) -> PredictedMasks:
    """The group with the largest map at each pixel, the void left out, and its mean map there.

    Args:
        group_maps: Rendered probabilities M_l without the void's, not divided by alpha.
        alphas: Rendered coverage.
        alpha_min: Pixels covered no more than this belong to no group.
    """
    maps = group_maps.detach().cpu().float().numpy()
    if maps.shape[0] == 0:
        return PredictedMasks(np.full(maps.shape[1:], -1), np.zeros(0))
    ids = maps.argmax(axis=0)
    best = np.take_along_axis(maps, ids[None], axis=0)[0]
    ids[(alphas.detach().cpu().numpy() <= alpha_min) | (best <= 0)] = -1
    kept = ids >= 0
    area = np.bincount(ids[kept], minlength=maps.shape[0])
    total = np.bincount(ids[kept], weights=best[kept], minlength=maps.shape[0])
    return PredictedMasks(ids, total / np.maximum(area, 1))


def match_image(
    true_ids: Int[np.ndarray, "height width"],
    predicted: PredictedMasks,
    settings: ApSettings = ApSettings(),
) -> ImageMatches:
    """Match the masks of one image to its instances, best first, at every threshold.

    A mask takes the free instance that it overlaps most. A mask that takes none is ignored when
    half or more of its pixels are ignored pixels or belong to instances below
    `min_instance_area`; otherwise it is a false positive.

    Args:
        true_ids: Instance of each pixel; 0 for none, -1 to ignore.
        predicted: Masks of the same size.
        settings: Areas and the meaning of id 0.
    """
    overlap, instances = _overlaps(true_ids, predicted.ids, len(predicted.scores))
    predicted_area = overlap.sum(axis=1)
    masks = np.flatnonzero(predicted_area >= max(settings.min_predicted_area, 1))
    masks = masks[np.lexsort((-predicted_area[masks], -predicted.scores[masks]))]
    overlap, predicted_area = overlap[masks], predicted_area[masks]

    unasked = instances < 0
    if settings.void == "ignore":
        unasked |= instances == 0
    true_area = np.array([(true_ids == instance).sum() for instance in instances], dtype=np.int64)
    small = (instances > 0) & (true_area < settings.min_instance_area)
    asked = (instances > 0) & ~small

    left = predicted_area - overlap[:, unasked].sum(axis=1)
    union = left[:, None] + true_area[None, asked] - overlap[:, asked]
    iou = overlap[:, asked] / np.maximum(union, 1)
    true_positive = np.stack([_greedy(iou, threshold) for threshold in IOU_THRESHOLDS])
    mostly_unasked = 2 * overlap[:, unasked | small].sum(axis=1) >= predicted_area
    return ImageMatches(
        scores=predicted.scores[masks],
        areas=predicted_area,
        true_positive=true_positive,
        ignored=~true_positive & mostly_unasked[None],
        num_instances=int(asked.sum()),
    )


@dataclass(frozen=True)
class RankedMasks:
    """The masks of many images in one ranking by confidence; equal ones by area."""

    true_positive: Bool[np.ndarray, "threshold mask"]
    ignored: Bool[np.ndarray, "threshold mask"]
    image_of_mask: Int[np.ndarray, " mask"]
    num_instances: Int[np.ndarray, " image"]


def average_precision(images: Iterable[ImageMatches]) -> InstanceAp:
    """AP over the masks of all images in one ranking by confidence; equal ones by area."""
    return average_precision_of(ranked_masks(images))


def ranked_masks(images: Iterable[ImageMatches]) -> RankedMasks:
    """All masks of some images in the order in which AP counts them."""
    images = list(images)
    counts = [len(image.scores) for image in images]
    scores = np.concatenate([np.zeros(0), *(image.scores for image in images)])
    areas = np.concatenate([np.zeros(0), *(image.areas for image in images)])
    order = np.lexsort((-areas, -scores))
    none = np.zeros((len(IOU_THRESHOLDS), 0), dtype=bool)
    return RankedMasks(
        np.concatenate([none, *(image.true_positive for image in images)], axis=1)[:, order],
        np.concatenate([none, *(image.ignored for image in images)], axis=1)[:, order],
        np.repeat(np.arange(len(images)), counts)[order],
        np.array([image.num_instances for image in images], dtype=np.int64),
    )


def average_precision_of(
    masks: RankedMasks, times: Int[np.ndarray, " image"] | None = None
) -> InstanceAp:
    """AP of masks that are ranked.

    Args:
        masks: Of some images.
        times: How often each image counts, as where images are drawn with replacement; None: once.
    """
    true_positive, ignored = masks.true_positive, masks.ignored
    num_instances = int(masks.num_instances.sum())
    if times is not None:
        of_mask = times[masks.image_of_mask]
        true_positive = np.repeat(true_positive, of_mask, axis=1)
        ignored = np.repeat(ignored, of_mask, axis=1)
        num_instances = int(masks.num_instances @ times)
    num_masks = true_positive.shape[1]
    if num_instances == 0:
        return InstanceAp(np.nan, np.nan, np.nan, 0, num_masks)
    each = [
        _interpolated(hits[~out], num_instances)
        for hits, out in zip(true_positive, ignored, strict=True)
    ]
    return InstanceAp(
        ap=float(np.mean(each[1:])),
        ap50=each[1],
        ap25=each[0],
        num_instances=num_instances,
        num_masks=num_masks,
        ap_scannet=float(np.mean(each[1:-1])),
    )


def scene_macro_ap(scenes: Sequence[Iterable[ImageMatches]]) -> InstanceAp:
    """Mean over scenes of the AP of each scene alone; scenes without an instance are left out."""
    each = [average_precision(images) for images in scenes]
    known = [one for one in each if one.num_instances]

    def mean(values: list[float]) -> float:
        return float(np.mean(values)) if values else np.nan

    return InstanceAp(
        ap=mean([one.ap for one in known]),
        ap50=mean([one.ap50 for one in known]),
        ap25=mean([one.ap25 for one in known]),
        num_instances=sum(one.num_instances for one in each),
        num_masks=sum(one.num_masks for one in each),
        ap_scannet=mean([one.ap_scannet for one in known]),
    )


def _overlaps(
    true_ids: Int[np.ndarray, "height width"],
    predicted_ids: Int[np.ndarray, "height width"],
    num_groups: int,
) -> tuple[Int[np.ndarray, "group instance"], Int[np.ndarray, " instance"]]:
    """Pixels shared by each group and each id of the true map, and those ids."""
    instances, columns = np.unique(true_ids, return_inverse=True)
    columns = columns.reshape(true_ids.shape)
    inside = predicted_ids >= 0
    cells = predicted_ids[inside] * len(instances) + columns[inside]
    counts = np.bincount(cells, minlength=num_groups * len(instances))
    return counts.reshape(num_groups, len(instances)), instances


def _greedy(iou: Float[np.ndarray, "mask instance"], threshold: float) -> Bool[np.ndarray, " mask"]:
    """Which masks, taken in order, find a free instance with at least this IoU."""
    matched = np.zeros(len(iou), dtype=bool)
    free = np.ones(iou.shape[1], dtype=bool)
    for mask in np.flatnonzero((iou >= threshold).any(axis=1)):
        open_iou = np.where(free, iou[mask], -1.0)
        best = int(open_iou.argmax())
        if open_iou[best] >= threshold:
            matched[mask], free[best] = True, False
    return matched


def _interpolated(hits: Bool[np.ndarray, " mask"], num_instances: int) -> float:
    """Mean of the precision envelope at the recalls 0, 0.01, ..., 1 (0 beyond the last recall)."""
    true_positives = np.cumsum(hits)
    precision = true_positives / np.arange(1, len(hits) + 1)
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    recall = true_positives / num_instances
    index = np.searchsorted(recall, np.linspace(0, 1, 101), side="left")
    return float(np.append(envelope, 0.0)[index].mean())
