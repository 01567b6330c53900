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
    shown = torch.zeros(len(cameras.intrinsics), height, width, dtype=torch.bool)
    before = history.source
    for edit in history.edits:
        if isinstance(edit, Remove):
            dropped = edit.dropped_rows(before) & drawn_rows(before)
            shown |= shown_share(before, dropped, cameras, height, width) > SHOWN
        before = edit.apply(before)
    if not shown.any():
        return shown
    left = now.gaussians.rows(drawn_rows(now))
    return shown & is_open(left, now.near_far, cameras, height, width)


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
    shown = shown_share(before, dropped & drawn, before.cameras, *size) > SHOWN
    left = before.gaussians.rows(drawn & ~dropped)
    return shown & is_open(left, before.near_far, before.cameras, *size)


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


def is_open(
    gaussians: Gaussians,
    near_far: tuple[float, float],
    cameras: Cameras,
    height: int,
    width: int,
) -> Bool[Tensor, "view height width"]:
    """Where one looks through all of the Gaussians."""
    near, far = near_far
    views = [
        render(gaussians, cameras.view(view), height, width, near=near, far=far).alphas[0]
        for view in range(len(cameras.intrinsics))
    ]
    clear = [1 - alphas > TRANSMITTANCE for alphas in views]
    return torch.stack(clear) if clear else torch.zeros(0, height, width, dtype=torch.bool)
