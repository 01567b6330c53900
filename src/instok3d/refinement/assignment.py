"""Gaussians at the borders of objects, and strays, given to the group whose pixels they show."""

from dataclasses import replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.render import render
from instok3d.types import Cameras, Gaussians

MIN_SHARE = 0.5
"""Of a Gaussian's visible weight that must lie in another group's pixels."""
MIN_WEIGHT = 0.5
"""Pixels' worth of visible weight below which a Gaussian keeps its group: it shows nothing."""


def reassigned(
    gaussians: Gaussians,
    assignment: Float[Tensor, "anchor column"],
    anchors: Float[Tensor, "anchor 3"],
    cameras: Cameras,
    height: int,
    width: int,
    *,
    near: float,
    far: float,
    winners: Int[Tensor, "view height width"] | None = None,
) -> Gaussians:
    """The Gaussians, some of them of another anchor; not differentiable.

    1. Each pixel of the views is won by a group or by the void, by the composited assignment.
    2. A Gaussian's weight in the views (alpha times transmittance) is summed by winner.
    3. Where more than MIN_SHARE of it lies in the pixels of one other group, the Gaussian goes to
       the nearest anchor of that group. The void takes none.

    Args:
        gaussians: One scene.
        assignment: Probabilities of each anchor, the void's last.
        anchors: Positions, scene units.
        cameras: Of the views, unbatched.
        height: Of the views, pixels.
        width: Of the views, pixels.
        near: Gaussians nearer than this z-depth are not drawn, scene units.
        far: Nor are those farther than this.
        winners: Of each pixel, where another rule than step 1 says so.
    """
    if not len(gaussians.means) or not len(anchors):
        return gaussians
    weights = weights_by_group(
        gaussians, assignment, cameras, height, width, near=near, far=far, winners=winners
    )
    owners = assignment.argmax(dim=1)
    total = weights.sum(dim=1)
    most, shown = weights.max(dim=1)
    void = assignment.shape[1] - 1
    moves = (
        (shown != owners[gaussians.anchor_index])
        & (shown != void)
        & (total >= MIN_WEIGHT)
        & (most > MIN_SHARE * total)
    )
    anchor_index = gaussians.anchor_index.clone()
    for group in shown[moves].unique().tolist():
        own_anchors = (owners == group).nonzero()[:, 0]
        if len(own_anchors):
            rows = (moves & (shown == group)).nonzero()[:, 0]
            distances = torch.cdist(gaussians.means[rows], anchors[own_anchors])
            anchor_index[rows] = own_anchors[distances.argmin(dim=1)]
    return replace(gaussians, anchor_index=anchor_index)


def weights_by_group(
    gaussians: Gaussians,
    assignment: Float[Tensor, "anchor column"],
    cameras: Cameras,
    height: int,
    width: int,
    *,
    near: float,
    far: float,
    winners: Int[Tensor, "view height width"] | None = None,
) -> Float[Tensor, "gaussian column"]:
    """Visible weight of each Gaussian in the pixels that each group wins, over all views."""
    if winners is None:
        winners = winning_columns(gaussians, assignment, cameras, height, width, near=near, far=far)
    return weights_by_region(gaussians, winners, assignment.shape[1], cameras, near=near, far=far)


@torch.no_grad()
def winning_columns(
    gaussians: Gaussians,
    assignment: Float[Tensor, "anchor column"],
    cameras: Cameras,
    height: int,
    width: int,
    *,
    near: float,
    far: float,
) -> Int[Tensor, "view height width"]:
    """The column of the assignment whose composited map is the largest at each pixel."""
    winners = torch.zeros(
        len(cameras.intrinsics), height, width, dtype=torch.long, device=assignment.device
    )
    for view in range(len(winners)):
        maps = render(
            gaussians, cameras.view(view), height, width,
            anchor_features=assignment, near=near, far=far,
        ).features  # fmt: skip
        assert maps is not None
        winners[view] = maps[0].argmax(dim=0)
    return winners


def weights_by_region(
    gaussians: Gaussians,
    regions: Int[Tensor, "view height width"],
    num_regions: int,
    cameras: Cameras,
    *,
    near: float,
    far: float,
) -> Float[Tensor, "gaussian region"]:
    """Visible weight of each Gaussian in the pixels of each region, over all views.

    A composited map is linear in the features of the Gaussians. Its gradient with respect to
    them, for maps that are compared with the regions, is therefore the weight that is asked for.

    Args:
        gaussians: One scene.
        regions: Of each pixel of each view, from 0.
        num_regions: How many there are. Time grows with those that a view has pixels of.
        cameras: Of the views, unbatched.
        near: Gaussians nearer than this z-depth are not drawn, scene units.
        far: Nor are those farther than this.
    """
    fixed = gaussians.map(Tensor.detach)
    alone = replace(fixed, anchor_index=torch.arange(len(fixed.means), device=fixed.means.device))
    weights = torch.zeros(len(fixed.means), num_regions, device=fixed.means.device)
    height, width = regions.shape[1:]
    for view in range(len(regions)):
        # Columns of the regions that have pixels alone: a tenth of all, and the others stay 0.
        there, column = regions[view].unique(return_inverse=True)
        features = weights.new_zeros(len(weights), len(there), requires_grad=True)
        with torch.enable_grad():
            own = render(
                alone, cameras.view(view), height, width,
                anchor_features=features, near=near, far=far,
            ).features  # fmt: skip
            assert own is not None
            own[0].gather(0, column[None]).sum().backward()
        assert features.grad is not None
        weights[:, there] += features.grad
    return weights
