"""Planes among what views of a scene show: floors, walls, table tops."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid, project, transform_points, unproject
from instok3d.types import Cameras, Gaussians, Rendering

SOLID = 0.8
"""Alpha from which on a pixel's depth is that of a surface."""
STEP = 1 / 64
"""Of the picture's longer side, 2 pixels at least: how far the points of which a normal is made
lie from its pixel. Depth is noisy from pixel to pixel."""
TOLERANCE = 0.03
"""Of a point's distance: how far it may lie from its plane. Predicted depth is wavy."""
MIN_COSINE = 0.85
"""Between the normal of a point and that of its plane."""
MIN_SHARE = 0.03
"""Of all points, or of those at the rim of a hole, that a plane needs."""
NEAR_SURFACE = 0.1
"""Of the rendered depth: how far the centre of a Gaussian may be from it that a pixel shows."""
MIN_CENTERS = 10
"""Gaussians that a plane is fitted to."""
MAX_PLANES = 8
TRIALS = 200
SAMPLE = 3000
"""Points that planes are looked for among."""
REFITS = 3
FARTHEST = 0.01
"""Weight of points far from the rim in the fit; those at the rim have 1."""
BEHIND_SHARE = 0.03
"""Of the points that may lie behind a plane that bounds the room."""


@dataclass(frozen=True)
class Look:
    """What views show of a scene."""

    cameras: Cameras
    colors: Float[Tensor, "view 3 height width"]
    alphas: Float[Tensor, "view height width"]
    depths: Float[Tensor, "view height width"]
    points: Float[Tensor, "view height width 3"]
    """In the world."""
    normals: Float[Tensor, "view height width 3"]
    """Unit length, towards the camera; zeros where there is none."""
    solid: Bool[Tensor, "view height width"]
    """Where there is a surface with a normal."""


@dataclass(frozen=True)
class Plane:
    """A flat surface."""

    normal: Float[Tensor, " 3"]
    """Unit length, towards the cameras."""
    offset: float
    """normal @ x = offset of its points."""
    inliers: Bool[Tensor, "view height width"]
    """Pixels that show it."""
    bounds_room: bool
    """Whether hardly anything that is seen lies behind it: a floor or a wall, which go on behind
    things; a table top ends somewhere."""


@torch.no_grad()
def look_at(pictures: Sequence[Rendering], cameras: Cameras) -> Look:
    """What views show of a scene, by a picture of each."""
    colors, alphas, depths = (
        torch.cat([vars(each)[name] for each in pictures])
        for name in ("colors", "alphas", "depths")
    )
    world_from_cam = invert_rigid(cameras.cam_from_world)
    local = unproject(depths, cameras.intrinsics)
    points = transform_points(world_from_cam, local.flatten(1, 2)).view_as(local)
    normals, known = _normals(points, alphas > SOLID)
    towards = world_from_cam[:, None, None, :3, 3] - points
    normals = normals * (normals * towards).sum(-1, keepdim=True).sign()
    return Look(cameras, colors, alphas, depths, points, normals, known)


def _normals(
    points: Float[Tensor, "view height width 3"], solid: Bool[Tensor, "view height width"]
) -> tuple[Float[Tensor, "view height width 3"], Bool[Tensor, "view height width"]]:
    """Normals from the points to the left, right, above and below, where all four are solid."""
    normals, known = torch.zeros_like(points), torch.zeros_like(solid)
    height, width = solid.shape[1:]
    step = max(2, round(STEP * max(height, width)))
    if min(height, width) <= 2 * step:
        return normals, known
    here, low, high = slice(step, -step), slice(None, -2 * step), slice(2 * step, None)
    right, left = points[:, here, high], points[:, here, low]
    below, above = points[:, high, here], points[:, low, here]
    across = torch.linalg.cross(right - left, below - above)
    normals[:, here, here] = torch.nn.functional.normalize(across, dim=-1)
    known[:, here, here] = (
        solid[:, here, here] & solid[:, here, high] & solid[:, here, low]
        & solid[:, high, here] & solid[:, low, here]
    )  # fmt: skip
    return normals, known


def find_planes(
    gaussians: Gaussians, look: Look, rim: Float[Tensor, "view height width"]
) -> list[Plane]:
    """The planes that the rim of a hole shows.

    1. Points are drawn at random, half of them near the rim.
    2. The plane through a point, by its normal, that most points fit is taken, they are set aside,
       and so on: sequential RANSAC.
    3. Each plane is fitted to its points again by least squares, those near the rim first: what is
       predicted is flat nearby rather than as a whole.
    4. It is then fitted to the centres of the Gaussians that its pixels show. Rendered depth is
       biased towards the camera where a surface is seen at a grazing angle, since the nearer ones
       of the Gaussians that a pixel touches are composited first.

    Args:
        gaussians: That are looked at.
        look: Without what was removed.
        rim: How near each pixel is to the hole, in [0, 1].
    """
    at = look.solid.nonzero(as_tuple=True)
    if len(at[0]) < 3:
        return []
    points, normals, nearness = look.points[at].double(), look.normals[at].double(), rim[at]
    generator = torch.Generator().manual_seed(0)
    uniform = torch.full_like(nearness, 1 / len(nearness))
    weights = (uniform + nearness / nearness.sum().clamp_min(1e-9)).double()
    count = min(SAMPLE, len(points))
    drawn = torch.multinomial(weights, count, generator=generator)
    tolerances = TOLERANCE * look.depths[at].double()
    left, planes = torch.arange(count), []
    while len(left) >= MIN_SHARE * count and len(planes) < MAX_PLANES:
        rest = drawn[left]
        seeds = rest[torch.randint(len(rest), (TRIALS,), generator=generator)]
        offsets = (normals[seeds] * points[seeds]).sum(1)
        flat = (points[rest] @ normals[seeds].T - offsets).abs() < tolerances[rest, None]
        fits = flat & (normals[rest] @ normals[seeds].T > MIN_COSINE)
        best = int(fits.sum(0).argmax())
        if int(fits[:, best].sum()) < MIN_SHARE * count:
            break
        normal, offset = normals[seeds[best]], offsets[best]
        for _ in range(REFITS):
            near = _fitting(points, normals, normal, offset, tolerances)
            if int(near.sum()) < 3:
                break
            normal, offset = _fitted(points[near], nearness[near].double() + FARTHEST, normal)
        chosen = _fitting(points, normals, normal, offset, tolerances)
        left = left[~(fits[:, best] | chosen[rest])]
        inliers = torch.zeros_like(look.solid)
        inliers[at] = chosen
        behind = points @ normal - offset < -3 * tolerances
        bounds = float(behind.double().mean()) < BEHIND_SHARE
        plane = Plane(normal.float(), float(offset), inliers, bounds)
        planes.append(_through_centers(plane, gaussians, look, rim))
    return planes


def pixels_of(
    look: Look, view: int, points: Float[Tensor, "point 3"]
) -> tuple[
    Int[Tensor, " point"], Int[Tensor, " point"], Float[Tensor, " point"], Bool[Tensor, " point"]
]:
    """Row, column and depth of each point in a view, and whether it is inside of the picture.

    Row and column are 0 where it is not.
    """
    height, width = look.alphas.shape[1:]
    local = transform_points(look.cameras.cam_from_world[view], points)
    pixels, depths = project(local, look.cameras.intrinsics[view]), local[:, 2]
    inside = (depths > 0) & (pixels >= 0).all(1) & (pixels[:, 0] < width) & (pixels[:, 1] < height)
    x, y = torch.where(inside[:, None], pixels, 0).long().T
    return y, x, depths, inside


def _through_centers(
    plane: Plane, gaussians: Gaussians, look: Look, rim: Float[Tensor, "view height width"]
) -> Plane:
    """The plane through the centres of the Gaussians that its pixels show."""
    weights = torch.zeros(len(gaussians.means))
    tolerances = torch.zeros_like(weights)
    for view in range(len(rim)):
        y, x, depths, inside = pixels_of(look, view, gaussians.means)
        near = (depths / look.depths[view, y, x] - 1).abs() < NEAR_SURFACE
        shown = inside & plane.inliers[view, y, x] & near
        weights = torch.maximum(weights, shown * (rim[view, y, x] + FARTHEST))
        tolerances = torch.maximum(tolerances, shown * TOLERANCE * depths)
    weights = (weights * gaussians.opacities).double()
    means, tolerances = gaussians.means.double(), tolerances.double()
    normal, offset = plane.normal.double(), torch.tensor(plane.offset, dtype=torch.float64)
    for times in (2.0, 1.0, 1.0):
        close = (weights > 0) & ((means @ normal - offset).abs() < times * tolerances)
        if int(close.sum()) < MIN_CENTERS:
            return plane
        normal, offset = _fitted(means[close], weights[close], normal)
    return replace(plane, normal=normal.float(), offset=float(offset))


def _fitting(
    points: Float[Tensor, "point 3"],
    normals: Float[Tensor, "point 3"],
    normal: Float[Tensor, " 3"],
    offset: Float[Tensor, ""],
    tolerances: Float[Tensor, " point"],
) -> Bool[Tensor, " point"]:
    """Which points lie on a plane and face as it does."""
    return ((points @ normal - offset).abs() < tolerances) & (normals @ normal > MIN_COSINE)


def _fitted(
    points: Float[Tensor, "point 3"], weights: Float[Tensor, " point"], before: Float[Tensor, " 3"]
) -> tuple[Float[Tensor, " 3"], Float[Tensor, ""]]:
    """Normal and offset of the plane through points, by weighted least squares."""
    center = (weights[:, None] * points).sum(0) / weights.sum()
    away = points - center
    normal = torch.linalg.eigh((weights[:, None] * away).T @ away)[1][:, 0]
    normal = normal * (normal @ before).sign()
    return normal, normal @ center
