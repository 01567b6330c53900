"""Which pixel of a view shows a point in space, if no other surface hides it there."""

from jaxtyping import Float, Int
from torch import Tensor

from instok3d.geometry.cameras import project, transform_points

DEPTH_TOLERANCE = 0.05
"""Relative difference of depths up to which a view shows the surface that a point lies on."""


def shown_points(
    points: Float[Tensor, "point 3"],
    cam_from_world: Float[Tensor, "4 4"],
    intrinsics: Float[Tensor, "3 3"],
    depth: Float[Tensor, "height width"],
) -> tuple[Int[Tensor, " shown"], Int[Tensor, " shown"]]:
    """The points that a view shows, and the pixels, row-major, that show them.

    A point is shown where it falls into a pixel whose depth is known and within DEPTH_TOLERANCE
    of its own: before that it hangs in the air, behind it is hidden.

    Args:
        points: World frame.
        cam_from_world: Of the view.
        intrinsics: Pixels.
        depth: z-depth of the view, 0 where it is unknown.
    """
    height, width = depth.shape
    moved = transform_points(cam_from_world, points)
    column, row = project(moved, intrinsics).floor().unbind(-1)
    inside = (moved[:, 2] > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    rows = inside.nonzero()[:, 0]
    pixels = row[rows].long() * width + column[rows].long()
    there, here = depth.flatten()[pixels], moved[rows, 2]
    same = (there > 0) & ((there - here).abs() <= DEPTH_TOLERANCE * here)
    return rows[same], pixels[same]
