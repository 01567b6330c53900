"""Proof that an edit touched nothing else: before and after, outside of the footprints."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Int
from torch import Tensor

from instok3d.render import render
from instok3d.scene.edits.ownership import drawn_rows, row_ids, same_degree
from instok3d.scene.record import SceneRecord
from instok3d.types import Cameras, Gaussians


@dataclass(frozen=True)
class Certificate:
    """What differs between two scenes outside of what was edited."""

    outside: float
    """Largest difference of colour, alpha or depth of pixels in no footprint; 0 is bit-equal."""
    pixels_outside: int
    """Pixels in no footprint, over all views."""
    pixels: int
    """All pixels of all views."""
    gone: int
    """Gaussians of the first scene that the second does not have."""
    new: int
    """Gaussians of the second scene that the first does not have."""


@torch.no_grad()
def certify(
    before: SceneRecord, after: SceneRecord, cameras: Cameras, height: int, width: int
) -> Certificate:
    """Compare pictures of what is drawn before and after an edit.

    The footprint is where a Gaussian that has gone, come, or changed its owner touches a pixel at
    all, by itself. What a pixel shows depends on the Gaussians that touch it alone and, of equal
    depth, on their order, which only changes of those that change their owner. So all other
    pixels must be equal bit for bit.

    Args:
        before: The scene whose limits of depth hold for both.
        after: The edited scene.
        cameras: From where to look; unbatched.
        height: Of the pictures, pixels.
        width: Likewise.
    """
    (first, own), (second, other) = _drawn(before), _drawn(after)
    gone, new = only_in_first(first, own, second, other), only_in_first(second, other, first, own)
    near, far = before.near_far
    outside, num_outside, views = 0.0, 0, len(cameras.intrinsics)
    for view in range(views):
        one = [
            render(each, cameras.view(view), height, width, near=near, far=far)
            for each in (first, second, first.rows(gone), second.rows(new))
        ]
        untouched = (one[2].alphas == 0) & (one[3].alphas == 0)
        num_outside += int(untouched.sum())
        for name in ("colors", "alphas", "depths"):
            apart = (vars(one[0])[name] - vars(one[1])[name]).abs()
            apart = apart.amax(dim=1) if apart.ndim == 4 else apart
            outside = max(outside, float(apart[untouched].max()) if untouched.any() else 0.0)
    pixels = views * height * width
    return Certificate(outside, num_outside, pixels, int(gone.sum()), int(new.sum()))


def _drawn(scene: SceneRecord) -> tuple[Gaussians, Int[Tensor, " gaussian"]]:
    """What is drawn of a scene, and the ids of its owners."""
    rows = drawn_rows(scene)
    return scene.gaussians.rows(rows), row_ids(scene)[rows]


def only_in_first(
    first: Gaussians,
    first_ids: Int[Tensor, " gaussian"],
    second: Gaussians,
    second_ids: Int[Tensor, " other"],
) -> Bool[Tensor, " gaussian"]:
    """Which Gaussians of the first, with their ids, are none of the second, bit for bit.

    Of equal ones as many count as the second lacks. Anchors are left aside.
    """
    first, second = same_degree(first, second)
    rows, others = _bytes(first, first_ids), _bytes(second, second_ids)
    _, kinds = np.unique(np.concatenate([rows, others]), return_inverse=True)
    kinds = torch.from_numpy(kinds)
    own, theirs = kinds[: len(rows)], kinds[len(rows) :]
    there = theirs.bincount(minlength=int(kinds.max()) + 1 if len(kinds) else 1)
    order = own.argsort(stable=True)
    counts = own.bincount(minlength=len(there))
    rank = torch.empty_like(own)
    rank[order] = torch.arange(len(own)) - (counts.cumsum(0) - counts)[own[order]]
    return rank >= there[own]


def _bytes(gaussians: Gaussians, ids: Int[Tensor, " gaussian"]) -> np.ndarray:
    """The bytes of each Gaussian and its id as one value that can be compared."""
    columns = [
        value.detach().cpu().reshape(len(value), math.prod(value.shape[1:])).numpy()
        for name, value in vars(gaussians).items()
        if name != "anchor_index"
    ]
    numbers = [each.view(np.uint8) for each in map(np.ascontiguousarray, columns)]
    table = np.ascontiguousarray(np.hstack([*numbers, ids.numpy()[:, None].view(np.uint8)]))
    return table.view(np.dtype((np.void, table.shape[1])))[:, 0]
