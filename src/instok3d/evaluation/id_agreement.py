"""Whether the same surface has the same object id in the views of one scene."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.data.sample import Sample
from instok3d.evaluation.prediction import RenderedIds
from instok3d.evaluation.sight_lines import shown_points
from instok3d.geometry.cameras import invert_rigid, transform_points, unproject
from instok3d.types import Cameras


def id_agreement(sample: Sample, rendered: RenderedIds) -> float | None:
    """Share of the pixels whose object id is that of the same surface in other views.

    Over the context and target views of a sample. True depth and true cameras say where the
    surface of a pixel lies in another view; where a sample has no true depth at all, the depth
    and the cameras of the rendering do.

    Args:
        sample: A batch of one, with true cameras.
        rendered: Its context views, then its targets.

    Returns:
        See `agreement`; None where no two views see the same surface.
    """
    context, target = sample.context, sample.target
    depths, cameras = rendered.depths, rendered.cameras
    if context.depths is not None and target.depths is not None:
        true = torch.cat([context.depths[0], target.depths[0]])
        if (true > 0).any():
            assert context.cam_from_world is not None
            assert context.intrinsics is not None
            assert target.cam_from_world is not None
            assert target.intrinsics is not None
            depths = true
            cameras = Cameras(
                torch.cat([context.cam_from_world[0], target.cam_from_world[0]]),
                torch.cat([context.intrinsics[0], target.intrinsics[0]]),
            )
    return agreement(rendered.ids, depths, cameras)


def agreement(
    ids: Int[Tensor, "view height width"],
    depths: Float[Tensor, "view height width"],
    cameras: Cameras,
) -> float | None:
    """Of the pixels that another view sees, the share that has the same id there.

    For every ordered pair of views, each pixel of the first one whose depth is known is moved into
    the second one and falls into a pixel there. It counts where that pixel's own depth is known
    and close to that of the moved point (`sight_lines`): both views then see the same surface.
    It agrees where both pixels belong to the same group; a pixel of no group agrees with none.
    Pooled over all pairs.

    Args:
        ids: -1 for no group.
        depths: z-depth, 0 where it is unknown.
        cameras: Of the views; no batch axis.

    Returns:
        In [0, 1]; None where no pixel counts.
    """
    agreeing = counting = 0
    for first in range(len(ids)):
        known = depths[first] > 0
        points = unproject(depths[first], cameras.intrinsics[first])[known]
        world = transform_points(invert_rigid(cameras.cam_from_world[first]), points)
        for second in range(len(ids)):
            if second == first:
                continue
            rows, pixels = shown_points(
                world, cameras.cam_from_world[second], cameras.intrinsics[second], depths[second]
            )
            id_here, id_there = ids[first][known][rows], ids[second].flatten()[pixels]
            counting += len(rows)
            agreeing += int(((id_here == id_there) & (id_here >= 0)).sum())
    return agreeing / counting if counting else None
