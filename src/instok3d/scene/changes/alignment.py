"""The similarity between the worlds of two captures of one room, on the objects they share.

Triples of objects that look alike propose similarities (RANSAC); the best are refined on points of
like colour, and the one under which the surfaces agree most is taken, if they agree enough.
"""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from instok3d.geometry.moving import Similarity
from instok3d.geometry.rotations import matrix_to_quat
from instok3d.geometry.similarity import weighted_procrustes
from instok3d.scene.changes.traits import COLOR_SPREAD, Traits, unlikeness

TRIALS, KEPT, BEST = 4000, 12, 2
"""Triples that are tried, proposals that are refined on few points, and then on all."""
AT_ONCE = 4_000_000
"""Pairs of objects, of all triples together, that are compared at once: 32 MB for each number."""
STEPS, FEW = 24, 1200
"""Of a refinement; points that are few."""
ALIKE = 1.6
"""Unlikeness up to which two objects may be the same."""
REACH, NEAR = 0.15, 0.05
"""In radii of the room: how far the objects of a proposal, and points of one surface, may be
apart."""
SPARSE = 3.0
"""Farthest that a point may be from a surface of few points, in distances that are near."""
AGREED = 0.4
"""Share of the points of either capture, of the one that shows less, which must lie on a surface of
the other one with its colour."""
SHARED = 3
"""Objects that must be shared."""
TILT = 0.5
"""Cosine between the two ups below which a proposal is not looked at."""


@dataclass(frozen=True)
class Alignment:
    """Where one capture's world lies in another's."""

    second_from_first: Similarity
    agreement: float
    """Share of the points that lie on a surface of the other capture, with its colour, [0, 1]."""
    residual: float
    """Median distance of these points from that surface, in the second's units."""
    near: float
    """Distance up to which points count as on a surface, in the second's units."""
    pairs: tuple[tuple[int, int], ...]
    """Rows of objects that agree in place and look."""
    matches: int = 0
    """Anchors that agree, where both captures have anchors of one model; else 0."""


def align(first: Traits, second: Traits, ups: tuple[Tensor, Tensor], *, seed: int = 0) -> Alignment:
    """The alignment of two captures of one room.

    Args:
        first: Of the capture that is carried along.
        second: Of the capture in whose world it is laid.
        ups: Up in either world, unit vectors.
        seed: Of the triples.

    Raises:
        ValueError: Too few objects look alike, or under no alignment do the captures agree.
    """
    likely = (unlikeness(first, second) < ALIKE).nonzero()
    if min(len(first.objects), len(second.objects), len(likely)) < SHARED:
        raise ValueError(
            f"the two scenes share too few objects to be aligned: {len(likely)} pairs look alike "
            f"of {len(first.objects)} and {len(second.objects)} objects, at least {SHARED} are "
            "needed; give two captures of one room that show much of the same"
        )
    few, others = _thinned(first), _thinned(second)
    tried = [_refined(few, others, each) for each in _proposals(first, second, likely, ups, seed)]
    tried.sort(key=lambda each: -each.agreement)
    found = [_refined(first, second, each.second_from_first) for each in tried[:BEST]]
    best = max(found, key=lambda each: each.agreement, default=None)
    if best is None or not best.agreement >= AGREED or len(best.pairs) < SHARED:
        reached = "no three objects fit" if best is None else (
            f"at best {best.agreement:.0%} of the surfaces and {len(best.pairs)} objects agree"
        )  # fmt: skip
        raise ValueError(
            f"no alignment of the two scenes can be trusted: {reached}, where {AGREED:.0%} and "
            f"{SHARED} are wanted; give two captures of one room that show much of the same"
        )
    return best


def fit_similarity(
    source: Float[Tensor, "*batch point 3"],
    target: Float[Tensor, "*batch point 3"],
    weights: Float[Tensor, "*batch point"],
) -> tuple[Float[Tensor, "*batch 3 3"], Float[Tensor, "*batch 3"], Float[Tensor, " *batch"]]:
    """Rotation R, translation t, scale s that bring s R source + t nearest to target.

    The scale is the ratio of the spreads, which favours neither direction.
    """
    share = (weights / weights.sum(-1, keepdim=True).clamp_min(1e-12))[..., None]
    from_middle = source - (share * source).sum(-2, keepdim=True)
    to_middle = target - (share * target).sum(-2, keepdim=True)
    own = (share * from_middle.square()).sum((-2, -1)).sqrt().clamp_min(1e-12)
    other = (share * to_middle.square()).sum((-2, -1)).sqrt().clamp_min(1e-12)
    scale = other / own
    # At unit spread, since the fit adds a small constant to keep gradients finite.
    rotation, _ = weighted_procrustes(
        from_middle / own[..., None, None], to_middle / other[..., None, None], weights
    )
    middle = (share * source).sum(-2)[..., None]
    translation = (share * target).sum(-2) - scale[..., None] * (rotation @ middle).squeeze(-1)
    return rotation, translation, scale


def _proposals(
    first: Traits,
    second: Traits,
    likely: Int[Tensor, "pair 2"],
    ups: tuple[Tensor, Tensor],
    seed: int,
) -> list[Similarity]:
    """The best similarities that triples of pairs give, best first."""
    generator = torch.Generator().manual_seed(seed)
    triples = likely[torch.randint(len(likely), (TRIALS, 3), generator=generator)]
    source, target = first.centers[triples[..., 0]], second.centers[triples[..., 1]]
    rotation, translation, scale = fit_similarity(source, target, torch.ones(TRIALS, 3).double())
    tilt = torch.einsum("i,tij,j->t", ups[1].double(), rotation, ups[0].double())
    sound = _distinct(triples) & (tilt > TILT) & (scale > 1e-6) & (scale < 1e6)
    rotation, translation, scale = rotation[sound], translation[sound], scale[sound]
    if not len(scale):
        return []
    alike = unlikeness(first, second)
    together = max(1, AT_ONCE // alike.numel())
    parts = zip(*(each.split(together) for each in (rotation, translation, scale)), strict=True)
    score = torch.cat([_fits(first, second, alike, *part) for part in parts])
    chosen: list[Similarity] = []
    for row in score.argsort(descending=True, stable=True)[: 8 * KEPT].tolist():
        each = similarity(rotation[row], translation[row], scale[row])
        # Triples of the same objects propose the same again and again.
        if all(_differs(each, other, first, second) for other in chosen):
            chosen.append(each)
        if len(chosen) == KEPT:
            break
    return chosen


def _fits(
    first: Traits,
    second: Traits,
    alike: Float[Tensor, "object other"],
    rotation: Float[Tensor, "trial 3 3"],
    translation: Float[Tensor, "trial 3"],
    scale: Float[Tensor, " trial"],
) -> Float[Tensor, " trial"]:
    """How many objects of the capture that has fewer find their like under each similarity."""
    moved = scale[:, None, None] * (first.centers @ rotation.mT) + translation[:, None]
    apart = torch.cdist(moved, second.centers) / (REACH * second.radius)
    sides = first.extents.log().mean(1)[:, None] - second.extents.log().mean(1)[None]
    sizes = (sides + scale.log()[:, None, None]) / 0.5
    fit = (-(apart**2) - sizes**2 - alike**2).exp()
    return fit.amax(2).sum(1).minimum(fit.amax(1).sum(1))


def _distinct(triples: Int[Tensor, "trial 3 2"]) -> Bool[Tensor, " trial"]:
    """Whether the three objects differ on both sides."""
    a, b, c = triples.unbind(1)
    return ((a != b) & (b != c) & (a != c)).all(dim=1)


def _differs(one: Similarity, other: Similarity, first: Traits, second: Traits) -> bool:
    apart = (one.points(first.centers) - other.points(first.centers)).norm(dim=1)
    return float(apart.max()) > 0.5 * REACH * second.radius


def _refined(first: Traits, second: Traits, start: Similarity) -> Alignment:
    """A proposal fitted to points of like colour, in steps of falling reach."""
    tree = KDTree(with_colors(second.points, second, second.radius).numpy())
    found = start
    for step in range(STEPS):
        reach = NEAR + (REACH - NEAR) * max(0.0, 1 - 1.5 * step / STEPS)
        moved = found.points(first.points)
        near, index = tree.query(
            with_colors(moved, first, second.radius).numpy(), distance_upper_bound=reach, workers=1
        )
        kept = torch.from_numpy(near < math.inf)
        if int(kept.sum()) < 30:
            break
        weights = (-((torch.from_numpy(near)[kept] / reach) ** 2)).exp()
        target = second.points[torch.from_numpy(index)[kept]]
        found = similarity(*fit_similarity(first.points[kept], target, weights))
    return measured(first, second, found)


def _thinned(traits: Traits) -> Traits:
    """The traits with FEW points at most, evenly among them."""
    step = max(1, len(traits.points) // FEW)
    return replace(
        traits, points=traits.points[::step], point_colors=traits.point_colors[::step],
        owners=traits.owners[::step], spacing=traits.spacing[::step] * step**0.5,
    )  # fmt: skip


def with_colors(
    points: Float[Tensor, "point 3"], traits: Traits, radius: float
) -> Float[Tensor, "point 6"]:
    """Points in radii with colours beside them: a usual difference of colour is worth NEAR."""
    return torch.cat([points / max(radius, 1e-12), NEAR * traits.point_colors / COLOR_SPREAD], 1)


def measured(first: Traits, second: Traits, found: Similarity) -> Alignment:
    """How well the surfaces and objects of two captures agree under a similarity."""
    near = NEAR * second.radius
    moved = replace(
        first, points=found.points(first.points), centers=found.points(first.centers),
        spacing=found.scale * first.spacing,
    )  # fmt: skip
    there, back = on_surfaces(moved, second, near), on_surfaces(second, moved, near)
    on_there, on_back = (each < math.inf for each in (there, back))
    agreement = max(float(on_there.double().mean()), float(on_back.double().mean()))
    least = min(float(on_there.double().mean()), float(on_back.double().mean()))
    both = torch.cat([there[on_there], back[on_back]])
    apart = torch.cdist(moved.centers, second.centers)
    fits = (apart < REACH * second.radius) & (unlikeness(first, second, found.scale) < ALIKE)
    cost = torch.where(fits, apart, math.inf)
    pairs = [
        (row, int(cost[row].argmin()))
        for row in range(len(cost))
        if cost[row].amin() < math.inf and int(cost[:, cost[row].argmin()].argmin()) == row
    ]
    return Alignment(
        found, (agreement + least) / 2, float(both.median()) if len(both) else math.inf, near,
        tuple(pairs),
    )  # fmt: skip


def on_surfaces(
    points: Traits, surfaces: Traits, near: float, of: int | None = None
) -> Float[Tensor, " point"]:
    """Distance of each point to the nearest point of like colour, infinite beyond `near`.

    Args:
        points: In one world with the surfaces.
        surfaces: What they may lie on.
        near: Longest distance, or twice the spacing of the surface's own points where these are
            farther apart.
        of: Row of the only object of the surfaces that counts; None for all that is drawn.
    """
    kept = slice(None) if of is None else surfaces.of_object(of)
    there, colors = surfaces.points[kept], surfaces.point_colors[kept]
    reach = (2 * surfaces.spacing[kept]).clamp(near, SPARSE * near)
    if not len(there) or not len(points.points):
        return torch.full((len(points.points),), math.inf, dtype=torch.float64)
    count = min(8, len(there))
    distance, index = KDTree(there.numpy()).query(
        points.points.numpy(), k=count, distance_upper_bound=SPARSE * near
    )
    reached = torch.from_numpy(distance).reshape(-1, count)  # of one neighbour it has no column
    place = torch.from_numpy(index).reshape(-1, count).clamp_max(len(there) - 1)
    reached = torch.where(reached < reach[place], reached, math.inf)
    alike = (colors[place] - points.point_colors[:, None]).norm(dim=2) < 1.5 * COLOR_SPREAD
    return torch.where(alike, reached, math.inf).amin(dim=1)


def similarity(rotation: Tensor, translation: Tensor, scale: Tensor) -> Similarity:
    """X -> scale * rotation x + translation, of tensors."""
    x, y, z = translation.tolist()
    w, i, j, k = matrix_to_quat(rotation).tolist()
    return Similarity((x, y, z), (w, i, j, k), float(scale))
