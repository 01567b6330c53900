"""Fills the hole of a removal by extending the planes at its rim; what it shows is invented."""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid, pixel_rays, transform_points
from instok3d.geometry.rotations import matrix_to_quat
from instok3d.geometry.spherical_harmonics import SH_CONSTANT
from instok3d.render import render
from instok3d.scene.edits.holes import hole_of, shown_share
from instok3d.scene.edits.ownership import drawn_rows, row_ids
from instok3d.scene.edits.surfaces import TOLERANCE, Look, Plane, find_planes, look_at, pixels_of
from instok3d.scene.edits.texture import continued
from instok3d.scene.id_maps import group_maps
from instok3d.scene.record import SceneRecord
from instok3d.types import Gaussians

SHOWN = 0.1
"""Share of a pixel that what is removed has where the fill may be seen."""
CLEAR = 0.15
"""Transmittance of what is left from which on a pixel is filled."""
RIM = 0.08
"""Of the picture's longer side: how far around the hole its rim reaches."""
MIN_RIM_SHARE = 0.04
"""Of the rim that shows a surface, that a plane needs to be extended."""
BEHIND = 0.03
"""Of the depth: how far a plane may come before the surface of what is removed, or before what
another view sees."""
MARGIN = 0.8
"""Of the extent of a patch: how far around it colours are taken from."""
FARTHEST = 1.5
"""Of the largest depth that is seen: beyond it nothing is invented."""
FLAT = 0.25
"""Share of a group's pixels that lie on a plane where it belongs to that plane."""
MAX_CELLS = 40_000
SPREAD = 0.6
"""Standard deviation of an invented Gaussian along the plane, in cells."""
THICKNESS = 0.05
"""The same across it."""
OPACITY = 0.95


@torch.no_grad()
def plane_fill(
    before: SceneRecord, dropped: Bool[Tensor, " gaussian"], after: SceneRecord
) -> tuple[Gaussians, Bool[Tensor, "view height width"]]:
    """Gaussians that extend the planes at the rim of a hole into it.

    1. The hole in each input view: pixels that showed what is removed and are not covered now.
    2. Planes are found in what is left, and kept where the rim shows them.
    3. Each pixel of the hole takes the nearest plane behind the surface of what was removed: any
       that bounds the room, and others between their own points alone, so that no table top grows
       into the hole of a chair.
    4. Each plane gets a grid as fine as the pixels. Cells that another view sees through are left.
    5. Colours of cells that views show are known; the others continue them (`texture`).

    Args:
        before: The scene before the removal, with input views.
        dropped: What goes of it.
        after: The scene without it.

    Returns:
        Gaussians of constant colour; anchor_index names anchors of the scene after, of the group
        that most of the plane at the rim belongs to. And the hole in each input view that they are
        for, as `holes.holes_after` finds it.
    """
    size = before.height, before.width
    shown = shown_share(before, dropped, before.cameras, *size)
    drawn = drawn_rows(after)
    left = after.gaussians.rows(drawn)
    look, groups = _seen(after, left)
    logged = hole_of(shown, look.alphas)
    hole = (shown > SHOWN) & (look.alphas < 1 - CLEAR)
    if not hole.any():
        return _none(after), logged
    rim = nearness(hole, max(2, round(RIM * max(size)))) * ~(shown > SHOWN)
    found = find_planes(left, look, rim)
    planes = [_without_things(each, groups, look.solid) for each in found]
    planes = [each for each in planes if _at_rim(each, look, rim)]
    # Where the rim shows nothing but things, as that of a piece of a table, they are extended.
    planes = planes or [each for each in found if _at_rim(each, look, rim)]
    which, points = _chosen_planes(look, _fronts(before, dropped), hole, planes)
    made = [_none(after)]
    for number, plane in enumerate(planes):
        wanted = which == number
        if wanted.any():
            made.append(_patch(after, look, plane, wanted, points, rim))
    return Gaussians.concatenate(made), logged


def nearness(
    hole: Bool[Tensor, "view height width"], reach: int
) -> Float[Tensor, "view height width"]:
    """1 beside a hole, falling to 0 at `reach` pixels from it; 0 within."""
    near, grown = torch.zeros(hole.shape), hole.float()[:, None]
    for step in range(reach):
        grown = torch.nn.functional.max_pool2d(grown, 3, stride=1, padding=1)
        near = torch.maximum(near, grown[:, 0] * (1 - step / reach))
    return near * ~hole


def _at_rim(plane: Plane, look: Look, rim: Float[Tensor, "view height width"]) -> bool:
    share = rim[plane.inliers].sum() / rim[look.solid].sum().clamp_min(1e-6)
    return float(share) >= MIN_RIM_SHARE


def _seen(scene: SceneRecord, drawn: Gaussians) -> tuple[Look, Int[Tensor, "view height width"]]:
    """What the input views show, and the group that each pixel shows most of, the void included."""
    near, far = scene.near_far
    maps = [
        group_maps(
            drawn, scene.tokens.assignment, scene.cameras.view(view), scene.height, scene.width,
            near=near, far=far,
        )
        for view in range(len(scene.cameras.intrinsics))
    ]  # fmt: skip
    look = look_at([each.picture for each in maps], scene.cameras)
    return look, torch.stack([each.groups for each in maps])


def _fronts(
    scene: SceneRecord, chosen: Bool[Tensor, " gaussian"]
) -> Float[Tensor, "view height width"]:
    """Depth of the surface of some Gaussians alone in the input views, 0 where there is none."""
    near, far = scene.near_far
    alone, fronts = scene.gaussians.rows(chosen), []
    for view in range(len(scene.cameras.intrinsics)):
        camera = scene.cameras.view(view)
        picture = render(alone, camera, scene.height, scene.width, near=near, far=far)
        fronts.append(torch.where(picture.alphas[0] > 0.05, picture.depths[0], 0))
    return torch.stack(fronts)


def _without_things(
    plane: Plane,
    groups: Int[Tensor, "view height width"],
    solid: Bool[Tensor, "view height width"],
) -> Plane:
    """The plane without the pixels of groups that touch it but mostly lie elsewhere."""
    count = int(groups.max()) + 1
    on_plane = groups[plane.inliers].bincount(minlength=count)
    share = on_plane / groups[solid].bincount(minlength=count).clamp_min(1)
    return replace(plane, inliers=plane.inliers & (share > FLAT)[groups])


def _chosen_planes(
    look: Look,
    fronts: Float[Tensor, "view height width"],
    hole: Bool[Tensor, "view height width"],
    planes: list[Plane],
) -> tuple[Int[Tensor, "view height width"], Float[Tensor, "view height width 3"]]:
    """The plane of each pixel of the hole, -1 for none, and the point on it, in the world."""
    _, height, width = hole.shape
    world_from_cam = invert_rigid(look.cameras.cam_from_world)
    centers = world_from_cam[:, None, None, :3, 3]
    rays = pixel_rays(look.cameras.intrinsics, height, width) @ world_from_cam[:, None, :3, :3].mT
    limit = FARTHEST * look.depths.amax()
    nearest = torch.full(hole.shape, torch.inf)
    which = torch.full(hole.shape, -1)
    for number, plane in enumerate(planes):
        depths = (plane.offset - centers @ plane.normal) / (rays @ plane.normal)
        behind = (depths > 0) & (depths >= (1 - BEHIND) * fronts) & (depths < limit)
        fits = hole & behind & (depths < nearest)
        if not plane.bounds_room:
            reach = centers + depths.nan_to_num(0, 0, 0)[..., None] * rays
            fits &= _between(plane, look, reach)
        nearest, which = torch.where(fits, depths, nearest), torch.where(fits, number, which)
    points = centers + nearest.nan_to_num(0, 0, 0)[..., None] * rays
    return which, points


def _axes(plane: Plane) -> Float[Tensor, "3 2"]:
    """Two directions along a plane, as columns."""
    helper = torch.eye(3)[int(plane.normal.abs().argmin())]
    first = torch.nn.functional.normalize(torch.linalg.cross(plane.normal, helper), dim=0)
    return torch.stack([first, torch.linalg.cross(plane.normal, first)], dim=1)


def _between(
    plane: Plane, look: Look, points: Float[Tensor, "view height width 3"]
) -> Bool[Tensor, "view height width"]:
    """Which points of a plane lie in the convex hull of those that are seen."""
    axes = _axes(plane)
    own = look.points[plane.inliers] @ axes
    there = points @ axes
    # As many directions as make the polygon of supporting lines as good as the hull.
    angles = torch.arange(32) * (2 * torch.pi / 32)
    directions = torch.stack([angles.cos(), angles.sin()])
    return (there @ directions <= (own @ directions).amax(0)).all(-1)


def _patch(
    after: SceneRecord,
    look: Look,
    plane: Plane,
    wanted: Bool[Tensor, "view height width"],
    points: Float[Tensor, "view height width 3"],
    rim: Float[Tensor, "view height width"],
) -> Gaussians:
    """The Gaussians that cover the pixels of a plane in which a hole is."""
    grid = _grid(look, plane, wanted, points)
    rows, columns, _ = grid.shape
    colors, known = torch.zeros(3, rows, columns), torch.zeros(rows, columns)
    chosen, seen_through = known > 0, known > 0
    for view in range(len(wanted)):
        found = pixels_of(look, view, grid.flatten(0, 1))
        y, x, depths, inside = (each.view(rows, columns) for each in found)
        chosen |= inside & wanted[view, y, x]
        behind = depths < (1 - BEHIND) * look.depths[view, y, x]
        seen_through |= inside & look.solid[view, y, x] & behind
        shows = inside & plane.inliers[view, y, x]
        colors += shows * look.colors[view][:, y, x]
        known += shows
    if not known.any():
        return _none(after)  # nothing says what the plane looks like
    chosen = torch.nn.functional.max_pool2d(chosen[None].float(), 3, 1, 1)[0] > 0
    chosen &= ~seen_through
    filled = continued(colors / known.clamp_min(1), known > 0, chosen)[:, chosen].T
    cell = float((grid[0, 1] - grid[0, 0]).norm())
    anchor = _anchor(after, look, plane, rim, grid[chosen])
    return _splats(after, plane, grid[chosen], filled, cell, anchor)


def _grid(
    look: Look,
    plane: Plane,
    wanted: Bool[Tensor, "view height width"],
    points: Float[Tensor, "view height width 3"],
) -> Float[Tensor, "row column 3"]:
    """Points on a plane around those that are wanted, as dense as pixels in the middle of them."""
    axes = _axes(plane)
    there = points[wanted] @ axes
    low, high = there.amin(0), there.amax(0)
    local = transform_points(look.cameras.cam_from_world, points.flatten(1, 2))[..., 2]
    depths = local.view(wanted.shape)[wanted]
    focal = look.cameras.intrinsics[:, 0, 0][wanted.nonzero()[:, 0]]
    cell = float((depths / focal).median())
    margin = MARGIN * (high - low).amax()
    low, high = low - margin, high + margin
    cell = max(cell, float(((high - low).prod() / MAX_CELLS).sqrt()))
    rows, columns = (int(n) + 2 for n in ((high - low) / cell).tolist())
    first = low[0] + cell * torch.arange(rows)
    second = low[1] + cell * torch.arange(columns)
    flat = torch.stack(torch.meshgrid(first, second, indexing="ij"), dim=-1)
    return plane.offset * plane.normal + flat @ axes.T


def _anchor(
    after: SceneRecord,
    look: Look,
    plane: Plane,
    rim: Float[Tensor, "view height width"],
    points: Float[Tensor, "point 3"],
) -> int:
    """The anchor of the invented Gaussians: the nearest one of the group that the plane is of.

    Of the group with the most opacity among the Gaussians that lie on the plane at the rim.
    """
    means, ids, drawn = after.gaussians.means, row_ids(after), drawn_rows(after)
    on_plane = (means @ plane.normal - plane.offset).abs()
    votes = torch.zeros(len(after.tokens.groups) + 1)
    for view in range(len(rim)):
        y, x, depths, inside = pixels_of(look, view, means)
        near = inside * rim[view, y, x] * (on_plane < TOLERANCE * depths)
        votes.index_add_(0, ids, near * drawn * after.gaussians.opacities)
    votes = votes if votes.any() else ids[drawn].bincount(minlength=len(votes)).float()
    own = (ids == int(votes.argmax())).nonzero()[:, 0]
    nearest = (means[own] - points.mean(0)).norm(dim=1).argmin()
    return int(after.gaussians.anchor_index[own[nearest]])


def _splats(
    after: SceneRecord,
    plane: Plane,
    points: Float[Tensor, "point 3"],
    colors: Float[Tensor, "point 3"],
    cell: float,
    anchor: int,
) -> Gaussians:
    """Flat Gaussians on a plane, one a cell."""
    count = len(points)
    sh = torch.zeros(count, after.gaussians.sh.shape[1], 3)
    sh[:, 0] = (colors - 0.5) / SH_CONSTANT
    turn = torch.cat([_axes(plane), plane.normal[:, None]], dim=1)
    scales = torch.tensor([SPREAD, SPREAD, THICKNESS]) * cell
    return Gaussians(
        points, matrix_to_quat(turn).expand(count, 4), scales.expand(count, 3),
        torch.full((count,), OPACITY), sh, torch.full((count,), anchor),
    )  # fmt: skip


def _none(scene: SceneRecord) -> Gaussians:
    return scene.gaussians.rows(slice(0, 0))
