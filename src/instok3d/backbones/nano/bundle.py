"""Cameras and coarse depth of many views, brought to agree on what they see of each other.

Bundle adjustment for views whose depth is predicted: the depth of neighbouring pixels is wrong
together, so instead of every point by itself a coarse grid of log depth changes moves, which is
held back as far as predicted depth is usually right.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.backbones.nano.threads import all_threads
from instok3d.geometry.cameras import invert_rigid
from instok3d.geometry.registration import rigid_from_twist, skew

NEAREST = 0.05
"""Depth at which a point counts as behind a camera."""
TRUST_MIN = 0.5
"""Matches that are less probable count for nothing."""


@dataclass(frozen=True)
class Sightings:
    """Points of one view and where another one sees them; a row is an ordered pair of views."""

    scenes: Int[Tensor, " sighting"]
    """Of the batch."""
    here: Int[Tensor, " sighting"]
    """The view whose points they are."""
    there: Int[Tensor, " sighting"]
    """The view that sees them."""
    points: Float[Tensor, "sighting point 3"]
    """In the frame of here, by its depth."""
    rays: Float[Tensor, "sighting point 2"]
    """Where each is seen: x/z, y/z in the frame of there."""
    precision: Float[Tensor, "sighting point 2 2"]
    """Inverse covariance of the rays."""
    depths: Float[Tensor, "sighting point"]
    """Depth of there in that place, > 0."""
    trust: Float[Tensor, "sighting point"]
    """Probability of the match."""
    places_here: Float[Tensor, "sighting point 2"]
    """x, y of each point in the image of here, from 0 to 1."""
    places_there: Float[Tensor, "sighting point 2"]
    """The same of its match in the image of there."""


@dataclass(frozen=True)
class BundleNoise:
    """How wrong the parts are; the defaults were measured on held-out rooms."""

    shared: float = 0.12
    """Matches of neighbours are wrong together: as many independent ones for each match."""
    depth: float = 0.14
    """Standard deviation of log depth, of what a node of the grid takes up."""
    depth_reach: float = 0.22
    """Over which that is alike (exponential), in lengths of the image's longer side."""
    fine_depth: float = 0.05
    """Of log depth, of what is finer than the grid."""
    mutual_depth: float = 0.08
    """Of the difference of two views' log depths of one point."""
    focal: float = 0.01
    """Of the logarithm of a focal length that is not known; where it is more, the error counts
    less and less (Cauchy), as a guess is mostly right or quite wrong."""
    agreement: float = 0.15
    """x/z, y/z from its place at which a match still agrees with the cameras of the start."""
    outlier: float = 2.0
    """Standard deviations at which an error has lost half its weight."""


@dataclass(frozen=True)
class SolveSettings:
    """Which values are solved for, and how wrong those may be that they start from."""

    depth_is_free: Float[Tensor, "batch view"]
    """1 where the depth of a view may change, 0 where it is known."""
    focal_is_free: bool = False
    """Whether the focal length of a scene, one for all its views, is a guess."""
    noise: BundleNoise = BundleNoise()


def coarse_grid(height: int, width: int, longer: int = 8) -> tuple[int, int]:
    """Rows and columns of the nodes: `longer` along the longer side, cells about square."""
    side = max(height, width)
    return max(1, round(longer * height / side)), max(1, round(longer * width / side))


def node_weights(
    places: Float[Tensor, "*batch 2"], grid: tuple[int, int]
) -> Float[Tensor, "*batch node"]:
    """Share of each node in the bilinear value at a place; the nodes are the cells' centres.

    What `interpolate(..., mode="bilinear", align_corners=False)` does, at any place.
    """
    shares = []
    for axis, nodes in ((1, grid[0]), (0, grid[1])):
        position = (places[..., axis, None] * nodes - 0.5).clamp(0, nodes - 1)
        number = torch.arange(nodes, device=places.device)
        shares.append((1 - (position - number).abs()).clamp_min(0))
    return (shares[0][..., :, None] * shares[1][..., None, :]).flatten(-2)


@torch.no_grad()
def adjust_bundle(
    sightings: Sightings,
    cam_from_first: Float[Tensor, "batch view 4 4"],
    settings: SolveSettings,
    grid: tuple[int, int],
    *,
    log_focal: Float[Tensor, " batch"] | None = None,
    iterations: int = 6,
) -> tuple[
    Float[Tensor, "batch view 4 4"], Float[Tensor, "batch view node"], Float[Tensor, " batch"]
]:
    """Better cameras, the change of log depth at each node of each view, and the log focal length.

    Not differentiable.

    Gauss-Newton on the robust (Cauchy) errors of the projections, of the depths of one point in
    two views, and of the prior of the depth. Along the line on which a point moves with its
    depth, an error of projection counts less, because the depth may be wrong. The first camera
    stays; the prior holds the length of a unit.

    Args:
        sightings: In the units of the cameras.
        cam_from_first: Where to start.
        settings: What is solved for, and what errors to expect.
        grid: Rows and columns of nodes.
        log_focal: Logarithm of the focal length over that of the sightings, where to start; none
            is 0, and stays 0 where it is known.
        iterations: Of Gauss-Newton.
    """
    batch, count = cam_from_first.shape[:2]
    nodes, noise = grid[0] * grid[1], settings.noise
    cameras, changes = cam_from_first, cam_from_first.new_zeros(batch, count, nodes)
    longer = cam_from_first.new_zeros(batch) if log_focal is None else log_focal
    if count < 2 or not len(sightings.scenes):
        return cameras, changes, longer
    here = node_weights(sightings.places_here, grid)
    there = node_weights(sightings.places_there, grid)
    trust = _agreed_trust(sightings, cameras, longer, noise.agreement)
    sightings = replace(sightings, trust=trust)
    prior = _prior_precision(grid, noise).to(changes)
    # A depth that is known is one whose prior is a thousand times as narrow.
    stiffness = torch.where(settings.depth_is_free > 0, 1.0, 1e6)[..., None, None] * prior
    for _ in range(iterations):
        equations = _normal_equations(sightings, cameras, changes, longer, here, there, noise)
        views = torch.arange(count, device=changes.device)
        equations.hessian[:, views, views, 6:, 6:] += stiffness
        equations.gradient[..., 6:] += (stiffness @ changes[..., None])[..., 0]
        narrow = 1 / (noise.focal**2 + longer.square())
        equations.focal_hessian.add_(narrow)
        equations.focal_gradient.add_(narrow * longer)
        step, focal_step = _solve(equations, focal_is_free=settings.focal_is_free)
        cameras = rigid_from_twist(step[..., :6]) @ cameras
        changes = (changes + step[..., 6:]).clamp(-0.7, 0.7)
        longer = (longer + focal_step.clamp(-0.1, 0.1)).clamp(-0.5, 0.5)
    return cameras, changes, longer


def counted_trust(trust: Float[Tensor, "*match"]) -> Float[Tensor, "*match"]:
    """From 0 at TRUST_MIN to 1."""
    return (trust - TRUST_MIN).clamp_min(0) / (1 - TRUST_MIN)


def _agreed_trust(
    sightings: Sightings,
    cameras: Float[Tensor, "batch view 4 4"],
    log_focal: Float[Tensor, " batch"],
    agreement: float,
) -> Float[Tensor, "sighting point"]:
    """Counted trust in each match, less where a pair contradicts the start.

    Views of different places of alike things have many sure and wrong matches. Theirs lie far
    from where the cameras, which came from better pairs, put the points.
    """
    trust = counted_trust(sightings.trust)
    there, here = (cameras[sightings.scenes, view] for view in (sightings.there, sightings.here))
    there_from_here = there @ invert_rigid(here)
    longer = log_focal[sightings.scenes].exp()[:, None, None]
    points = torch.cat([sightings.points[..., :2] / longer, sightings.points[..., 2:]], dim=-1)
    seen = points @ there_from_here[:, :3, :3].mT + there_from_here[:, None, :3, 3]
    placed = longer * seen[..., :2] / seen[..., 2:].clamp_min(NEAREST)
    error = (placed - sightings.rays).norm(dim=-1)
    agrees = (error < agreement) & (seen[..., 2] > NEAREST)
    share = (trust * agrees).sum(-1) / trust.sum(-1).clamp_min(1e-9)
    return trust * ((share - 0.5) / 0.3).clamp(0, 1)[:, None]


def _prior_precision(grid: tuple[int, int], noise: BundleNoise) -> Float[Tensor, "node node"]:
    """Inverse covariance of the nodes: exponential in their distance."""
    rows, columns = grid
    places = torch.cartesian_prod(torch.arange(float(rows)), torch.arange(float(columns)))
    distance = torch.cdist(places, places) / max(grid)
    covariance = noise.depth**2 * torch.exp(-distance / noise.depth_reach)
    # What the exponential lets two neighbours differ by is little: some of it is each node's own.
    covariance = covariance + 0.005 * noise.depth**2 * torch.eye(len(places))
    return torch.linalg.inv(covariance)


@dataclass(frozen=True)
class _Equations:
    """Hessian and gradient over (twist, nodes) of all views, and over the log focal length."""

    hessian: Float[Tensor, "batch view view part part"]
    gradient: Float[Tensor, "batch view part"]
    focal_hessian: Float[Tensor, " batch"]
    focal_gradient: Float[Tensor, " batch"]
    focal_cross: Float[Tensor, "batch view part"]
    """Between the focal length and the others."""


def _normal_equations(
    sightings: Sightings,
    cameras: Float[Tensor, "batch view 4 4"],
    changes: Float[Tensor, "batch view node"],
    log_focal: Float[Tensor, " batch"],
    hats_here: Float[Tensor, "sighting point node"],
    hats_there: Float[Tensor, "sighting point node"],
    noise: BundleNoise,
) -> _Equations:
    scenes, here, there = sightings.scenes, sightings.here, sightings.there
    there_from_here = cameras[scenes, there] @ invert_rigid(cameras[scenes, here])
    deeper_here = (hats_here @ changes[scenes, here, :, None])[..., 0]
    deeper_there = (hats_there @ changes[scenes, there, :, None])[..., 0]
    errors = _point_errors(
        sightings, there_from_here, deeper_here, deeper_there, log_focal[scenes], noise
    )
    twist, of_here, of_there = errors.by_twist, errors.by_depth_here, errors.by_depth_there
    of_focal = errors.by_focal

    twists = twist.flatten(1, 2).mT @ twist.flatten(1, 2)
    cross_here = (twist * of_here[..., None]).sum(2).mT @ hats_here
    cross_there = (twist * of_there[..., None]).sum(2).mT @ hats_there
    with all_threads():  # most of the solver's work, large enough to share
        nodes_here = (hats_here * of_here.square().sum(-1)[..., None]).mT @ hats_here
        nodes_there = (hats_there * of_there.square().sum(-1)[..., None]).mT @ hats_there
        nodes_mixed = (hats_here * (of_here * of_there).sum(-1)[..., None]).mT @ hats_there
    twist_gradient = (twist * errors.values[..., None]).sum((1, 2))
    gradient_here = ((of_here * errors.values).sum(-1)[:, None] @ hats_here)[:, 0]
    gradient_there = ((of_there * errors.values).sum(-1)[:, None] @ hats_there)[:, 0]

    twist_focal = (twist * of_focal[..., None]).sum((1, 2))
    focal_here = ((of_here * of_focal).sum(-1)[:, None] @ hats_here)[:, 0]
    focal_there = ((of_there * of_focal).sum(-1)[:, None] @ hats_there)[:, 0]

    # A small motion of camera here moves what is seen as the opposite motion of camera there,
    # brought over to it.
    carry = -_adjoint(there_from_here)
    batch, count, parts_of_view = *cameras.shape[:2], 6 + changes.shape[-1]
    hessian = twists.new_zeros(batch, count, count, parts_of_view, parts_of_view)
    gradient = twists.new_zeros(batch, count, parts_of_view)
    of_there_alone = (twists, cross_there, cross_there.mT, nodes_there)
    carried = carry.mT @ twists
    of_here_alone = (carried @ carry, carry.mT @ cross_here, cross_here.mT @ carry, nodes_here)
    mixed = (carried, carry.mT @ cross_there, cross_here.mT, nodes_mixed)
    for a, b, blocks in (
        (there, there, of_there_alone),
        (here, here, of_here_alone),
        (here, there, mixed),
        (there, here, (mixed[0].mT, mixed[2].mT, mixed[1].mT, mixed[3].mT)),
    ):
        top, bottom = torch.cat(blocks[:2], dim=-1), torch.cat(blocks[2:], dim=-1)
        block = torch.cat([top, bottom], dim=-2)
        # Not index_put_, which adds in any order where there are several threads.
        hessian.flatten(0, 2).index_add_(0, (scenes * count + a) * count + b, block)

    cross = torch.zeros_like(gradient)
    carried_gradient = (carry.mT @ twist_gradient[..., None])[..., 0]
    carried_focal = (carry.mT @ twist_focal[..., None])[..., 0]
    for view, parts, focal_parts in (
        (there, (twist_gradient, gradient_there), (twist_focal, focal_there)),
        (here, (carried_gradient, gradient_here), (carried_focal, focal_here)),
    ):
        row = scenes * count + view
        gradient.flatten(0, 1).index_add_(0, row, torch.cat(parts, dim=-1))
        cross.flatten(0, 1).index_add_(0, row, torch.cat(focal_parts, dim=-1))
    nothing = gradient.new_zeros(len(cameras))
    return _Equations(
        hessian,
        gradient,
        nothing.index_add(0, scenes, of_focal.square().sum((1, 2))),
        nothing.index_add(0, scenes, (of_focal * errors.values).sum((1, 2))),
        cross,
    )


@dataclass(frozen=True)
class _PointErrors:
    """Errors of all points in units of their deviation, robustly weighted, and derivatives.

    Three each: of the projection, x/z and y/z, and of the logarithms of depth.
    """

    values: Float[Tensor, "sighting point 3"]
    by_twist: Float[Tensor, "sighting point 3 6"]
    """Of camera there."""
    by_depth_here: Float[Tensor, "sighting point 3"]
    """By the log depth of the point."""
    by_depth_there: Float[Tensor, "sighting point 3"]
    """By the log depth of its match."""
    by_focal: Float[Tensor, "sighting point 3"]
    """By the log focal length of both cameras."""


def _point_errors(
    sightings: Sightings,
    there_from_here: Float[Tensor, "sighting 4 4"],
    deeper_here: Float[Tensor, "sighting point"],
    deeper_there: Float[Tensor, "sighting point"],
    log_focal: Float[Tensor, " sighting"],
    noise: BundleNoise,
) -> _PointErrors:
    # A longer focal length brings the points nearer to the axis. Where they are seen is compared
    # in the rays of the sightings, which are pixels: in true x/z any error would shrink with it.
    longer = log_focal.exp()[:, None, None]
    points = torch.cat([sightings.points[..., :2] / longer, sightings.points[..., 2:]], dim=-1)
    points = points * deeper_here.exp()[..., None]
    turned = points @ there_from_here[:, :3, :3].mT
    seen = turned + there_from_here[:, None, :3, 3]
    front = seen[..., 2] > NEAREST
    z = seen[..., 2].clamp_min(NEAREST)
    u, v, w = seen[..., 0] / z, seen[..., 1] / z, 1 / z
    zero = torch.zeros_like(u)
    by_twist = torch.stack(
        [
            longer * torch.stack([w, zero, -u * w, -u * v, 1 + u * u, -v], dim=-1),
            longer * torch.stack([zero, w, -v * w, -1 - v * v, u * v, u], dim=-1),
            torch.stack([zero, zero, w, v, -u, zero], dim=-1),
        ],
        dim=-2,
    )
    placed = torch.stack([u, v], dim=-1)
    slope = longer * (turned[..., :2] - placed * turned[..., 2:]) * w[..., None]
    by_depth_here = torch.cat([slope, turned[..., 2:] * w[..., None]], dim=-1)
    inward = -points[..., :2] @ there_from_here[:, :3, :2].mT
    by_focal = longer * (placed + (inward[..., :2] - placed * inward[..., 2:]) * w[..., None])
    by_focal = torch.cat([by_focal, inward[..., 2:] * w[..., None]], dim=-1)
    mutual = (z / sightings.depths.clamp_min(NEAREST)).log() - deeper_there
    values = torch.cat([longer * placed - sightings.rays, mutual[..., None]], dim=-1)
    # Ray errors have the covariance precision^-1 + fine_depth^2 slope slope^T. Its inverse, by
    # Sherman and Morrison, is root root^T with a lower triangle as root.
    pull = (sightings.precision @ slope[..., None])[..., 0]
    fine = noise.fine_depth**2
    taken = fine / (1 + fine * (slope * pull).sum(-1))
    inverse = sightings.precision - taken[..., None, None] * pull[..., :, None] * pull[..., None, :]
    root_x = inverse[..., 0, 0].clamp_min(1e-9).sqrt()
    root_xy = inverse[..., 0, 1] / root_x
    root_y = (inverse[..., 1, 1] - root_xy.square()).clamp_min(1e-9).sqrt()
    share = noise.shared * sightings.trust * front
    roots = torch.stack([root_x, root_xy, root_y], dim=-1)
    values = _in_deviations(values[..., None], roots, noise)[..., 0]
    of_ray = (share / (1 + values[..., :2].square().sum(-1) / noise.outlier**2)).sqrt()
    of_mutual = (share / (1 + values[..., 2].square() / noise.outlier**2)).sqrt()
    weight = torch.stack([of_ray, of_ray, of_mutual], dim=-1)
    nothing = torch.zeros_like(by_depth_here)
    nothing[..., 2] = -1 / noise.mutual_depth
    return _PointErrors(
        values * weight,
        _in_deviations(by_twist, roots, noise) * weight[..., None],
        _in_deviations(by_depth_here[..., None], roots, noise)[..., 0] * weight,
        nothing * weight,
        _in_deviations(by_focal[..., None], roots, noise)[..., 0] * weight,
    )


def _in_deviations(
    rows: Float[Tensor, "sighting point 3 column"],
    roots: Float[Tensor, "sighting point 3"],
    noise: BundleNoise,
) -> Float[Tensor, "sighting point 3 column"]:
    """Projections and log depth in units of their deviation; root is [[x, xy], [0, y]]."""
    x, y, log_depth = rows.unbind(-2)
    root_x, root_xy, root_y = roots[..., None].unbind(-2)
    return torch.stack(
        [root_x * x + root_xy * y, root_y * y, log_depth / noise.mutual_depth], dim=-2
    )


def _adjoint(transform: Float[Tensor, "sighting 4 4"]) -> Float[Tensor, "sighting 6 6"]:
    """What a twist before the transform is after it."""
    rotation, translation = transform[:, :3, :3], transform[:, :3, 3]
    top = torch.cat([rotation, skew(translation) @ rotation], dim=-1)
    bottom = torch.cat([torch.zeros_like(rotation), rotation], dim=-1)
    return torch.cat([top, bottom], dim=-2)


def _solve(
    equations: _Equations, *, focal_is_free: bool
) -> tuple[Float[Tensor, "batch view part"], Float[Tensor, " batch"]]:
    """The Gauss-Newton step, and that of the log focal length; the first camera has none."""
    hessian, gradient = equations.hessian, equations.gradient
    batch, count, _, size, _ = hessian.shape
    whole = hessian.permute(0, 1, 3, 2, 4).reshape(batch, count * size, count * size).double()
    number = torch.arange(count * size, device=hessian.device)
    is_twist = number % size < 6
    diagonal = whole.diagonal(dim1=-2, dim2=-1)
    damping = 1e-4 * diagonal[:, is_twist].mean(-1, keepdim=True).clamp_min(1e-6) * is_twist
    free = number >= 6
    whole = (whole + torch.diag_embed(damping))[:, free][:, :, free]
    # The focal length is the last unknown; where it is known, nothing depends on it.
    cross = equations.focal_cross.flatten(1).double()[:, free, None] * focal_is_free
    own = equations.focal_hessian.double()[:, None, None]
    whole = torch.cat([torch.cat([whole, cross], 2), torch.cat([cross.mT, own], 2)], dim=1)
    right = gradient.flatten(1).double()[:, free, None]
    slope = equations.focal_gradient.double()[:, None, None] * focal_is_free
    found = -torch.cholesky_solve(torch.cat([right, slope], 1), torch.linalg.cholesky(whole))
    step = gradient.new_zeros(batch, count * size)
    step[:, free] = found[:, :-1, 0].to(step)
    step = step.view(batch, count, size)
    # A step of more than 30 degrees or half a unit is a sign of too few matches: shorten it.
    longest = step[..., :6].norm(dim=-1).amax(dim=1).clamp_min(1e-9)
    return step * (0.5 / longest).clamp_max(1.0)[:, None, None], found[:, -1, 0].to(step)
