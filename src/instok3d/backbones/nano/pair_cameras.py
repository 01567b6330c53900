"""Cameras of all views from the matches of pairs of them, and what the matches say of depth."""

from dataclasses import replace

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from instok3d.backbones.nano.alignment import align_matches
from instok3d.backbones.nano.bundle import (
    NEAREST,
    BundleNoise,
    SolveSettings,
    adjust_bundle,
    coarse_grid,
    counted_trust,
)
from instok3d.backbones.nano.matching import join_matches
from instok3d.backbones.nano.pair_matches import (
    PairMatches,
    PhotoViews,
    SolvedViews,
    matched_cells,
    pair_sightings,
    thinned,
)
from instok3d.backbones.nano.threads import one_thread
from instok3d.geometry.cameras import invert_rigid, transform_points
from instok3d.geometry.registration import compose_along_tree, register_pair, spanning_tree

THINNED_ROUNDS, FULL_ROUNDS = 3, 2
"""So many times matches are aligned by the cameras and the cameras solved from them: a quarter of
them until the cameras are nearly right, then all."""
ROUNDS_ALONE = 5
"""The same for a pair that is to be placed among others; a quarter of its matches is enough."""
SHARED_ALONE = 0.1
"""As many independent matches an aligned one of a pair alone is worth."""
SHARED_TOGETHER = 0.3
"""The same where other pairs see the same places: their errors are not those of its neighbours."""
AGREEMENT_TOGETHER = 0.05
"""x/z, y/z at which a match agrees with cameras that came from aligned pairs."""


@one_thread()
@torch.no_grad()
def solve_views(
    pairs: list[PairMatches],
    views: PhotoViews,
    settings: SolveSettings,
) -> SolvedViews:
    """The cameras under which all matches fit best, and depth moved with them.

    With the cameras the photos say more exactly where the matches lie, from which come better
    cameras, and so on in turn. Of more than two views every pair first does so alone: one wrong
    pair would pull all others along. The pairs whose matches then fit best make the tree along
    which they are chained, and from there all views are adjusted together. Not differentiable.

    Args:
        pairs: Matches of enough pairs to link all views.
        views: The cameras come out in units of their depths.
        settings: What is solved for, and what errors to expect of the depths.
    """
    if not pairs:
        first = torch.eye(4).to(views.depths).expand(*views.depths.shape[:2], 4, 4)
        return unsolved(views, first.clone())
    few = thinned(pairs, views)
    if len(pairs) == 1:
        solved = _adjust(few, views, unsolved(views, _register(pairs[0], views)), settings)
    else:
        solved = unsolved(views, _chain_pairs(pairs, views, settings))
    for matches in [few] * THINNED_ROUNDS + [pairs] * FULL_ROUNDS:
        solved = improve_views(matches, views, solved, settings)
    return solved


def unsolved(views: PhotoViews, cam_from_first: Float[Tensor, "batch view 4 4"]) -> SolvedViews:
    """Some cameras, with depths and focal length as they are."""
    nothing = torch.zeros_like(views.depths)
    return SolvedViews(cam_from_first, nothing[:, 0, 0, 0], nothing)


@one_thread()
@torch.no_grad()
def improve_views(
    pairs: list[PairMatches], views: PhotoViews, solved: SolvedViews, settings: SolveSettings
) -> SolvedViews:
    """One round more: the matches aligned by what is solved, and everything solved from them.

    Args:
        pairs: As they were found, all matches or some.
        views: As in `solve_views`.
        solved: Where to begin.
        settings: As in `solve_views`; the depths are those of `views`.
    """
    if not pairs:
        return solved
    aligned = align_pairs(pairs, views.moved(solved), solved.cam_from_first)
    if len(pairs) > 1:
        noise = replace(settings.noise, shared=SHARED_TOGETHER, agreement=AGREEMENT_TOGETHER)
    else:  # no other could say that it is wrong
        noise = replace(settings.noise, shared=SHARED_ALONE)
    return _adjust(aligned, views, solved, replace(settings, noise=noise))


@one_thread()
def align_pairs(
    pairs: list[PairMatches], views: PhotoViews, cam_from_first: Float[Tensor, "batch view 4 4"]
) -> list[PairMatches]:
    """All matches moved to where the photos agree best, near where cameras and depth put them."""
    aligned = []
    for pair in pairs:
        of_a, of_b = (
            align_matches(matches, views.at(here, cam_from_first), views.at(there, cam_from_first))
            for here, there, matches in pair.ways
        )
        aligned.append(replace(pair, of_a=of_a, of_b=of_b))
    return aligned


def _adjust(
    pairs: list[PairMatches], views: PhotoViews, solved: SolvedViews, settings: SolveSettings
) -> SolvedViews:
    height, width = views.depths.shape[-2:]
    grid = coarse_grid(height, width)
    sightings = pair_sightings(pairs, views)
    cam_from_first, changes, log_focal = adjust_bundle(
        sightings, solved.cam_from_first, settings, grid, log_focal=solved.log_focal
    )
    deeper = functional.interpolate(
        changes.unflatten(-1, grid), size=(height, width), mode="bilinear", align_corners=False
    )
    return SolvedViews(cam_from_first, log_focal, deeper)


def _register(pair: PairMatches, views: PhotoViews) -> Float[Tensor, "batch 2 4 4"]:
    """cam_from_first of the two views of a pair, from where descriptors and depth put it."""
    b_from_a = register_pair(*matched_cells(pair, views))
    return torch.stack([torch.eye(4).to(b_from_a).expand_as(b_from_a), b_from_a], dim=1)


def _chain_pairs(
    pairs: list[PairMatches], views: PhotoViews, settings: SolveSettings
) -> Float[Tensor, "batch view 4 4"]:
    """cam_from_first of every view: all pairs solved alone, the best-supported ones composed."""
    batch, count = views.depths.shape[:2]
    pair, scenes, both = _as_scenes(pairs, batch)
    alone = PhotoViews(
        views.images[scenes, both], views.depths[scenes, both], views.intrinsics[scenes, both]
    )
    settings = SolveSettings(settings.depth_is_free[scenes, both], noise=settings.noise)
    few = thinned([pair], alone)
    solved = _adjust(few, alone, unsolved(alone, _register(pair, alone)), settings)
    for _ in range(ROUNDS_ALONE):
        solved = improve_views(few, alone, solved, settings)
    support = _support(few, alone, solved, settings.noise).view(-1, batch)
    b_from_a = solved.cam_from_first[:, 1].unflatten(0, (-1, batch))
    found = []
    for scene in range(batch):
        edges = [(int(p.views_a[scene]), int(p.views_b[scene])) for p in pairs]
        scores = views.depths.new_full((count, count), -1.0)  # never chosen: no such pair
        steps = {}
        for number, (a, b) in enumerate(edges):
            scores[a, b] = support[number, scene]
            steps[a, b] = b_from_a[number, scene]
            steps[b, a] = invert_rigid(steps[a, b])
        tree = spanning_tree(scores)
        found.append(compose_along_tree({edge: steps[edge] for edge in tree}, tree))
    return torch.stack(found).to(views.depths)


def _as_scenes(
    pairs: list[PairMatches], batch: int
) -> tuple[PairMatches, Int[Tensor, "row 1"], Int[Tensor, "row 2"]]:
    """Every pair of every scene as a scene of two views; which scene, and which views of it."""
    views_a, views_b = [p.views_a for p in pairs], [p.views_b for p in pairs]
    both = torch.stack([torch.cat(views_a), torch.cat(views_b)], dim=1)
    zero = torch.zeros_like(both[:, 0])
    pair = PairMatches(
        zero,
        zero + 1,
        join_matches([p.of_a for p in pairs]),
        join_matches([p.of_b for p in pairs]),
    )
    scenes = torch.arange(batch, device=zero.device).repeat(len(pairs))[:, None]
    return pair, scenes, both


def _support(
    pairs: list[PairMatches], views: PhotoViews, solved: SolvedViews, noise: BundleNoise
) -> Float[Tensor, " batch"]:
    """How many matches, aligned, lie where the cameras put them; wrong pairs have few of these."""
    views = views.moved(solved)
    aligned = align_pairs(pairs, views, solved.cam_from_first)
    sightings = pair_sightings(aligned, views)
    there, here = (
        solved.cam_from_first[sightings.scenes, view] for view in (sightings.there, sightings.here)
    )
    seen = transform_points(there @ invert_rigid(here), sightings.points)
    off = seen[..., :2] / seen[..., 2:].clamp_min(NEAREST) - sightings.rays
    squared = (off[..., None, :] @ sightings.precision @ off[..., None])[..., 0, 0]
    weight = counted_trust(sightings.trust) / (1 + squared / noise.outlier**2)
    return squared.new_zeros(len(views.depths)).index_add(0, sightings.scenes, weight.sum(-1))
