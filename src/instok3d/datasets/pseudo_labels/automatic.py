"""Masks of everything in an image from a model that segments what a point lies on."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor
from torch.nn.functional import interpolate

from instok3d.datasets.pseudo_labels.interfaces import ProposedMasks
from instok3d.datasets.pseudo_labels.mask_sets import suppressed, without_small_regions


@dataclass(frozen=True)
class PointMasks:
    """What a model takes the things at some points for."""

    logits: Float[Tensor, "point candidate rows columns"]
    """Of the whole image on a grid of the model's own; in the mask where > 0."""
    ious: Float[Tensor, "point candidate"]
    """How right the model thinks each mask is: the IoU with the true one that it predicts."""


PointPrompt = Callable[[Float[Tensor, "point 2"]], PointMasks]
"""The masks of the things at points (x, y) in [0, 1] of the image's width and height."""


@runtime_checkable
class PointSegmenter(Protocol):
    """A promptable model, such as SAM 2."""

    def look_at(self, image: UInt8[np.ndarray, "height width 3"], /) -> PointPrompt:
        """Read an image once, to be asked about many points."""
        ...


@dataclass(frozen=True)
class AutomaticConfig:
    """Which masks are good enough: SAM 2's own defaults, but for min_region_share."""

    points_per_side: int = 32
    """The grid of point prompts has so many rows and columns."""
    points_at_once: int = 64
    min_predicted_iou: float = 0.8
    min_stability: float = 0.95
    """IoU of the mask's cuts at the logits +stability_offset and -stability_offset."""
    stability_offset: float = 1.0
    max_overlap: float = 0.7
    """Masks that overlap a better one by more are it again. Of masks, where SAM compares boxes."""
    min_region_share: float = 0.0005
    """Islands and holes below this share of the image are removed."""

    def __post_init__(self):
        if self.points_per_side < 1 or self.points_at_once < 1:
            raise ValueError(
                "points_per_side and points_at_once must be 1 or more, got "
                f"{self.points_per_side} and {self.points_at_once}"
            )


class AutomaticMasks:
    """A `MaskProposer` that asks a promptable model about a grid of points."""

    def __init__(self, segmenter: PointSegmenter, config: AutomaticConfig = AutomaticConfig()):
        self.segmenter, self.config = segmenter, config

    def propose(self, image: UInt8[np.ndarray, "height width 3"]) -> ProposedMasks:
        """The masks that are sure, stable, unlike each other and not empty; best first."""
        ask, shape = self.segmenter.look_at(image), image.shape[:2]
        logits, scores = [], []
        for points in point_grid(self.config.points_per_side).split(self.config.points_at_once):
            found = ask(points)
            good = (found.ious >= self.config.min_predicted_iou) & (
                stability(found.logits, self.config.stability_offset) >= self.config.min_stability
            )
            logits.append(found.logits[good].cpu().float())
            scores.append(found.ious[good].cpu().float())
        candidates, ious = torch.cat(logits), torch.cat(scores).numpy().astype(np.float64)
        kept = suppressed((candidates > 0).numpy(), ious, self.config.max_overlap)
        masks = self._cleaned([at_size(candidates[k], shape) for k in kept], shape)
        ious = ious[kept]
        there = masks.any(axis=(1, 2))
        masks, ious = masks[there], ious[there]
        # Without their islands two masks can be the same thing.
        kept = suppressed(masks, ious, self.config.max_overlap)
        return ProposedMasks(masks[kept], ious[kept])

    def _cleaned(
        self, masks: list[Bool[np.ndarray, "height width"]], shape: tuple[int, int]
    ) -> Bool[np.ndarray, "mask height width"]:
        min_area = int(np.ceil(self.config.min_region_share * shape[0] * shape[1]))
        cleaned = [without_small_regions(mask, min_area) for mask in masks]
        return np.stack(cleaned) if cleaned else np.zeros((0, *shape), dtype=bool)


def point_grid(per_side: int) -> Float[Tensor, "point 2"]:
    """Points (x, y) at the centres of a grid over [0, 1] x [0, 1], row by row."""
    steps = (torch.arange(per_side) + 0.5) / per_side
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    return torch.stack([x, y], dim=-1).reshape(-1, 2)


def stability(logits: Float[Tensor, "*mask rows columns"], offset: float) -> Float[Tensor, "*mask"]:
    """How little a mask changes with its threshold: area above +offset over area above -offset."""
    inner = (logits > offset).sum(dim=(-2, -1))
    outer = (logits > -offset).sum(dim=(-2, -1))
    return inner / outer.clamp(min=1)


def at_size(
    logits: Float[Tensor, "rows columns"], shape: tuple[int, int]
) -> Bool[np.ndarray, "height width"]:
    """The mask at the image's size: logits interpolated bilinearly, then cut at 0."""
    resized = interpolate(logits[None, None].float(), size=shape, mode="bilinear")
    return (resized[0, 0] > 0).cpu().numpy()
