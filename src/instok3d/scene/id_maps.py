"""Which group a pixel shows: the group or void whose composited map is the largest there."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.render import render
from instok3d.types import Cameras, Gaussians, Rendering

COLUMNS = 512
"""Maps that are composited at a time: those of an imported scene with thousands of groups could
fill the memory."""


@dataclass(frozen=True)
class GroupMaps:
    """What the groups win of one view."""

    groups: Int[Tensor, "height width"]
    """Index of the winning group; the number of groups where the void wins."""
    scores: Float[Tensor, "height width"]
    """The winner's composited map, in [0, 1]."""
    picture: Rendering
    """What the view shows, without the maps."""


def group_maps(
    gaussians: Gaussians,
    assignment: Float[Tensor, "anchor column"],
    camera: Cameras,
    height: int,
    width: int,
    *,
    near: float,
    far: float,
) -> GroupMaps:
    """The winners of one view, not differentiable.

    The groups' maps are their assignment probabilities composited like colours (Sec. 3.2). The void
    has a map too, and what no Gaussian covers is added to it. (The evaluation of Sec. 4 leaves
    the void out, since every pixel there counts for some group; a scene does not, since a wall
    that is no object must not be handed to the nearest chair.)

    Args:
        gaussians: Unbatched.
        assignment: Probabilities of each anchor, the void's last.
        camera: One view.
        height: Of the view, pixels.
        width: Of the view, pixels.
        near: Gaussians nearer than this z-depth are not drawn, scene units.
        far: Nor are those farther than this.
    """
    winners = scores = picture = None
    for first in range(0, assignment.shape[1], COLUMNS):
        columns = assignment[:, first : first + COLUMNS]
        rendering = render(
            gaussians, camera, height, width, anchor_features=columns, near=near, far=far
        )
        assert rendering.features is not None
        maps, picture = rendering.features[0], replace(rendering, features=None)
        if first + COLUMNS >= assignment.shape[1]:
            maps = torch.cat([maps[:-1], maps[-1:] + (1 - rendering.alphas)])
        best, groups = maps.max(dim=0)
        if winners is None or scores is None:
            winners, scores = groups, best
        else:
            winners = torch.where(best > scores, groups + first, winners)
            scores = torch.maximum(best, scores)
    assert winners is not None
    assert scores is not None
    assert picture is not None
    return GroupMaps(winners, scores.clamp(0, 1), picture)
