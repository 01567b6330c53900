"""Masks of single photos as a segmentation network gets them wrong, made from the true ones."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Int
from scipy import ndimage
from torch import Tensor


@dataclass(frozen=True)
class DegradationSettings:
    """How often each kind of fault happens, for each instance in each view."""

    missed: float = 0.1
    """Share of instances without a mask."""
    joined: float = 0.1
    """That have one mask with the neighbour along whose border most of theirs runs."""
    halved: float = 0.15
    """That have two masks, cut along a line through their middle."""
    border_px: float = 1.5
    """Deviation of the smooth displacement of all borders, pixels."""

    def __post_init__(self) -> None:
        for name in ("missed", "joined", "halved"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be in [0, 1], got {getattr(self, name)}")
        if self.border_px < 0:
            raise ValueError(f"border_px must be 0 or more, got {self.border_px}")


SMOOTHNESS_PX = 4.0
"""Length over which the displacement of borders changes."""


def degraded_masks(
    instances: Int[Tensor, "view height width"],
    *,
    seed: Sequence[int],
    settings: DegradationSettings = DegradationSettings(),
) -> Int[Tensor, "view height width"]:
    """Each view's masks with faults of its own; ids say nothing across views.

    Borders are moved first, then instances joined, halved, missed. The same seed gives the same
    faults.

    Args:
        instances: True ids; below 1 is no instance.
        seed: Of the faults.
        settings: How often they happen.

    Returns:
        Ids 1, 2, ... in each view anew; 0 = no mask.
    """
    maps = []
    for view, ids in enumerate(instances.cpu().numpy()):
        random = np.random.default_rng([*seed, view])
        maps.append(torch.from_numpy(_degraded(ids, random, settings)))
    return torch.stack(maps).to(instances.device) if maps else instances


def _degraded(
    true_ids: Int[np.ndarray, "height width"],
    random: np.random.Generator,
    settings: DegradationSettings,
) -> Int[np.ndarray, "height width"]:
    ids = _displaced(np.maximum(true_ids, 0), random, settings.border_px)
    names = [int(name) for name in np.unique(ids) if name > 0]
    faults = random.random((len(names), 3)) < [settings.joined, settings.halved, settings.missed]
    angles_rad = random.uniform(0, np.pi, len(names))
    for name, fault in zip(names, faults, strict=True):
        if fault[0]:
            ids[ids == name] = _nearest_neighbor(ids, name)
    free = max(names, default=0) + 1
    for number, (name, fault) in enumerate(zip(names, faults, strict=True)):
        rows, columns = np.nonzero(ids == name)
        if fault[1] and len(rows):
            across = np.array([np.sin(angles_rad[number]), np.cos(angles_rad[number])])
            places = np.stack([rows - rows.mean(), columns - columns.mean()], axis=1)
            second = places @ across > 0
            ids[rows[second], columns[second]] = free + number
    for name, fault in zip(names, faults, strict=True):
        if fault[2]:
            ids[ids == name] = 0
    found, places = np.unique(ids, return_inverse=True)
    return np.arange(len(found))[places].reshape(ids.shape) + (0 if 0 in found else 1)


def _displaced(
    ids: Int[np.ndarray, "height width"], random: np.random.Generator, border_px: float
) -> Int[np.ndarray, "height width"]:
    """Every pixel takes the id of one nearby, by a smooth field."""
    height, width = ids.shape
    field = random.standard_normal((2, height, width))
    smooth = ndimage.gaussian_filter(field, (0, SMOOTHNESS_PX, SMOOTHNESS_PX), mode="wrap")
    moved = smooth / max(float(smooth.std()), 1e-12) * border_px
    rows, columns = np.mgrid[:height, :width] + np.round(moved).astype(int)
    return ids[rows.clip(0, height - 1), columns.clip(0, width - 1)]


def _nearest_neighbor(ids: Int[np.ndarray, "height width"], name: int) -> int:
    """The instance with the longest common border; itself where there is none."""
    mask = ids == name
    around = ndimage.binary_dilation(mask) & ~mask & (ids > 0)
    return int(np.bincount(ids[around]).argmax()) if around.any() else name
