"""Holes that removals leave: where a picture showed what was removed, and shows nothing now."""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from instok3d.render import render
from instok3d.scene.edits.history import History
from instok3d.scene.edits.operations import Remove
from instok3d.scene.edits.ownership import drawn_rows
from instok3d.scene.record import SceneRecord
from instok3d.types import Cameras, Gaussians

SHOWN = 0.25
"""Share of a pixel that what is removed has where it counts as seen."""
TRANSMITTANCE = 0.5
"""Transmittance of what is left from which on a pixel belongs to the hole."""


@torch.no_grad()
def holes_left(
    history: History, now: SceneRecord, cameras: Cameras, height: int, width: int
) -> Bool[Tensor, "view height width"]:
    """The pixels that showed what was removed and through which one now looks.

    The removed Gaussians are the footprint in space, so that any camera will do: each removal is
    done anew from the source of the history. What came later into a hole, moved there or invented
    by a fill, closes it.

    Args:
        history: Of the scene; removals among its edits count.
        now: The scene after them.
        cameras: Unbatched.
        height: Of the pictures, pixels.
        width: Likewise.
    """
    shown = torch.zeros(len(cameras.intrinsics), height, width)
    before = history.source
    for edit in history.edits:
        if isinstance(edit, Remove):
            dropped = edit.dropped_rows(before)
            here = shown_share(before, dropped, cameras, height, width)
            shown = torch.maximum(shown, here)
        before = edit.apply(before)
    if not shown.any():
        return shown > SHOWN
    left = now.gaussians.rows(drawn_rows(now))
    return hole_of(shown, alphas_of(left, now.near_far, cameras, height, width))


@torch.no_grad()
def holes_after(
    before: SceneRecord, dropped: Bool[Tensor, " gaussian"]
) -> Bool[Tensor, "view height width"]:
    """The hole in each input view that a removal will leave.

    Args:
        before: The scene as it is.
        dropped: The Gaussians that will go.
    """
    drawn, size = drawn_rows(before), (before.height, before.width)
    shown = shown_share(before, dropped, before.cameras, *size)
    left = before.gaussians.rows(drawn & ~dropped)
    return hole_of(shown, alphas_of(left, before.near_far, before.cameras, *size))


def hole_of(
    shown: Float[Tensor, "view height width"], alphas: Float[Tensor, "view height width"]
) -> Bool[Tensor, "view height width"]:
    """The hole, by the share that what is removed has and the alpha of what is left."""
    return (shown > SHOWN) & (1 - alphas > TRANSMITTANCE)


def shown_share(
    scene: SceneRecord,
    chosen: Bool[Tensor, " gaussian"],
    cameras: Cameras,
    height: int,
    width: int,
) -> Float[Tensor, "view height width"]:
    """The share of each pixel that some of the Gaussians have, behind and before the others."""
    rows = drawn_rows(scene)
    marked = replace(scene.gaussians, anchor_index=chosen.long()).rows(rows)
    near, far = scene.near_far
    share = torch.zeros(len(cameras.intrinsics), height, width)
    for view in range(len(share)):
        features = render(
            marked, cameras.view(view), height, width, near=near, far=far,
            anchor_features=torch.tensor([[0.0], [1.0]]),
        ).features  # fmt: skip
        assert features is not None
        share[view] = features[0, 0]
    return share


def alphas_of(
    gaussians: Gaussians,
    near_far: tuple[float, float],
    cameras: Cameras,
    height: int,
    width: int,
) -> Float[Tensor, "view height width"]:
    """How much of each pixel Gaussians cover."""
    near, far = near_far
    alphas = torch.zeros(len(cameras.intrinsics), height, width)
    for view in range(len(alphas)):
        picture = render(gaussians, cameras.view(view), height, width, near=near, far=far)
        alphas[view] = picture.alphas[0]
    return alphas
