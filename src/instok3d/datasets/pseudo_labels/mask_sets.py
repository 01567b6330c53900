"""Sets of masks that may overlap: how much they do, which of them to keep, who is on top."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt16
from scipy import ndimage

_PIXELS_AT_ONCE = 1 << 17


def overlap_ious(
    masks: Bool[np.ndarray, "mask height width"], others: Bool[np.ndarray, "other height width"]
) -> Float[np.ndarray, "mask other"]:
    """Intersection over union of every pair; 0 for two empty masks."""
    pixels = masks.shape[1] * masks.shape[2]
    first, second = masks.reshape(len(masks), pixels), others.reshape(len(others), pixels)
    shared = np.zeros((len(first), len(second)))
    for start in range(0, pixels if shared.size else 0, _PIXELS_AT_ONCE):
        block = slice(start, start + _PIXELS_AT_ONCE)
        shared += first[:, block].astype(np.float32) @ second[:, block].astype(np.float32).T
    union = first.sum(axis=1)[:, None] + second.sum(axis=1)[None] - shared
    return shared / np.maximum(union, 1)


def suppressed(
    masks: Bool[np.ndarray, "mask height width"],
    scores: Float[np.ndarray, " mask"],
    max_iou: float,
) -> Int[np.ndarray, " kept"]:
    """Which masks stay, best first, when each takes out the later ones that are nearly itself.

    Args:
        masks: May overlap.
        scores: Larger is better; the earlier mask wins between equals.
        max_iou: Masks that overlap a better one by more than this go.
    """
    order = np.argsort(-scores, kind="stable")
    ious = overlap_ious(masks[order], masks[order])
    kept: list[int] = []
    for place in range(len(order)):
        if not (ious[place, kept] > max_iou).any():
            kept.append(place)
    return order[kept]


def without_small_regions(
    mask: Bool[np.ndarray, "height width"], min_area: int
) -> Bool[np.ndarray, "height width"]:
    """The mask with its small holes filled and its small islands removed (4-connected).

    A mask that is all small islands keeps the largest one.
    """
    holes, areas = _regions(~mask)
    filled = mask | ((areas < min_area)[holes] & (holes > 0))
    islands, areas = _regions(filled)
    areas[0] = 0
    return np.isin(islands, np.flatnonzero(areas >= max(1, min(min_area, areas.max()))))


def _regions(
    mask: Bool[np.ndarray, "height width"],
) -> tuple[Int[np.ndarray, "height width"], Int[np.ndarray, " region"]]:
    """Which connected region each pixel is in, 0 = outside the mask, and the pixels of each."""
    found: Any = ndimage.label(mask)  # its declared type allows far more than pairs
    regions, count = found
    return regions, np.bincount(regions.ravel(), minlength=count + 1)


def visible_shares(
    masks: Bool[np.ndarray, "mask height width"],
) -> Float[np.ndarray, " mask"]:
    """How much of each mask no smaller one covers; 0 for an empty mask."""
    areas = masks.sum(axis=(1, 2))
    covered = np.zeros(masks.shape[1:], dtype=bool)
    shares = np.zeros(len(masks))
    for number in np.argsort(areas, kind="stable"):
        shares[number] = (masks[number] & ~covered).sum() / max(areas[number], 1)
        covered |= masks[number]
    return shares


def painted(
    masks: Sequence[Bool[np.ndarray, "height width"]],
    scores: Sequence[float],
    ids: Sequence[int],
    shape: tuple[int, int],
) -> UInt16[np.ndarray, "height width"]:
    """An id map, 0 where there is no mask: smaller masks lie on larger ones, surer on less sure.

    Args:
        masks: All of the given shape.
        scores: Decide between masks of equal area.
        ids: In 1 to 65535, one for each mask.
        shape: Height and width.
    """
    id_map = np.zeros(shape, dtype=np.uint16)
    areas = [int(mask.sum()) for mask in masks]
    for number in sorted(range(len(masks)), key=lambda k: (-areas[k], scores[k])):
        id_map[masks[number]] = ids[number]
    return id_map
