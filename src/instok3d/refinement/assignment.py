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
    """Visible weight of each Gaussian in the pixels that each group wins, over all views.

    A composited map is linear in the features of the Gaussians. Its gradient with respect to
    them, for maps that are compared with the winners, is therefore the weight that is asked for.
    """
    fixed = gaussians.map(Tensor.detach)
    alone = replace(fixed, anchor_index=torch.arange(len(fixed.means), device=fixed.means.device))
    weights = torch.zeros(len(fixed.means), assignment.shape[1], device=fixed.means.device)
    for view in range(len(cameras.intrinsics)):
        camera = cameras.view(view)
        if winners is None:
            with torch.no_grad():
                maps = render(
                    fixed, camera, height, width, anchor_features=assignment, near=near, far=far
                ).features
            assert maps is not None
            here = maps[0].argmax(dim=0)
        else:
            here = winners[view]
        won, column = here.unique(return_inverse=True)
        # Columns of the groups that win a pixel alone: a tenth of all, and the others stay 0.
        features = weights.new_zeros(len(weights), len(won), requires_grad=True)
        with torch.enable_grad():
            own = render(
                alone, camera, height, width, anchor_features=features, near=near, far=far
            ).features
            assert own is not None
            own[0].gather(0, column[None]).sum().backward()
        assert features.grad is not None
        weights[:, won] += features.grad
    return weights
