"""The photos that Gaussians are compared with: sizes from coarse to fine, and whose turn it is."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from instok3d.geometry.cameras import resize_intrinsics
from instok3d.types import Cameras


@dataclass(frozen=True)
class Supervision:
    """Photos of one size with their cameras."""

    photos: Float[Tensor, "view 3 height width"]
    """sRGB in [0, 1]."""
    cameras: Cameras
    """Unbatched; intrinsics for this size."""
    weights: Float[Tensor, "view 1 height width"] | None = None
    """Of each pixel in the comparison, in [0, 1]; None counts all."""

    @staticmethod
    def of(
        photos: Float[Tensor, "view 3 height width"],
        cameras: Cameras,
        known: Bool[Tensor, "view _ _"] | None = None,
    ) -> "Supervision":
        """Photos, and which of their pixels count (of the photos' height and width).

        Raises:
            ValueError: The sizes or numbers of views do not agree, or no pixel counts.
        """
        count = len(photos)
        if len(cameras.intrinsics) != count or len(cameras.cam_from_world) != count:
            raise ValueError(
                f"{count} photos need as many cameras, got {len(cameras.cam_from_world)} poses "
                f"and {len(cameras.intrinsics)} intrinsics"
            )
        if known is None:
            return Supervision(photos, cameras)
        if known.shape != (count, *photos.shape[-2:]):
            raise ValueError(
                f"masks of {tuple(known.shape)} do not fit photos of {tuple(photos.shape)}"
            )
        if not known.any():
            raise ValueError("every pixel of every photo is masked: there is nothing to refine on")
        return Supervision(photos, cameras, known[:, None].to(photos.dtype))

    def halved(self) -> "Supervision":
        """At half the size: the mean over two by two pixels that count; a last odd row is cut."""
        cameras = Cameras(
            self.cameras.cam_from_world,
            resize_intrinsics(self.cameras.intrinsics, scale_x=0.5, scale_y=0.5),
        )
        if self.weights is None:
            return Supervision(functional.avg_pool2d(self.photos, 2), cameras)
        weights = functional.avg_pool2d(self.weights, 2)
        sums = functional.avg_pool2d(self.photos * self.weights, 2)
        return Supervision(sums / weights.clamp_min(1e-6), cameras, weights)

    def views(self, indices: list[int]) -> "Supervision":
        """Some of the views."""
        weights = None if self.weights is None else self.weights[indices]
        return Supervision(self.photos[indices], self.cameras.views(indices), weights)


def pyramid(full: Supervision, *, coarse_side: int) -> list[Supervision]:
    """The photos from coarse to fine, each twice the size of the one before; the last is `full`."""
    levels = [full]
    while max(levels[0].photos.shape[-2:]) >= 2 * coarse_side:
        if min(levels[0].photos.shape[-2:]) < 2:
            break
        levels.insert(0, levels[0].halved())
    return levels


def level_of_step(step: int, steps: int, levels: int, coarse_share: float) -> int:
    """Which level a step sees: all but the last share the first `coarse_share` of the steps."""
    coarse = coarse_share * steps
    if levels == 1 or step >= coarse:
        return levels - 1
    return int(step / coarse * (levels - 1))


def turns(views: int, per_step: int, *, seed: int) -> Iterator[list[int]]:
    """Without end: which views each step sees, in rising order.

    All views where there are no more than `per_step`; else the views are shuffled again and again
    and dealt out, so that each has had its turn before one has its second.
    """
    generator = torch.Generator().manual_seed(seed)
    waiting: list[int] = []
    while True:
        if views <= per_step:
            yield list(range(views))
            continue
        chosen: list[int] = []
        while len(chosen) < per_step:
            if not waiting:
                waiting = torch.randperm(views, generator=generator).tolist()
            fresh = [view for view in waiting if view not in chosen]
            if not fresh:
                waiting = []
                continue
            chosen.append(fresh[0])
            waiting.remove(fresh[0])
        yield sorted(chosen)
