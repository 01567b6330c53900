"""Cameras and depth corrections of all views from matches between pairs of views."""

from dataclasses import replace

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from instok3d.backbones.nano.alignment import align_matches
from instok3d.backbones.nano.bundle import adjust_bundle
from instok3d.backbones.nano.bundle_problem import (
    NEAREST,
    BundleNoise,
    SolveSettings,
    confidence_weight,
)
from instok3d.backbones.nano.depth_grid import coarse_grid
from instok3d.backbones.nano.matching import join_matches
from instok3d.backbones.nano.pair_matches import (
    PairMatches,
    PhotoViews,
    SolvedViews,
    Ways,
    matched_cells,
    pair_observations,
    subsample_matches,
)
from instok3d.backbones.nano.threads import one_thread
from instok3d.geometry.cameras import invert_rigid, transform_points
from instok3d.geometry.registration import compose_along_tree, register_pair, spanning_tree

SUBSAMPLED_ROUNDS, FULL_ROUNDS = 3, 2
"""Rounds of alignment and bundle adjustment: with a quarter of the matches until the cameras are
nearly right, then with all."""
ROUNDS_ALONE = 5
"""Rounds for each pair on its own, before the pairs are chained; a quarter of the matches."""
INDEPENDENCE_ALONE = 0.1
"""Weight of an aligned match when only one pair observes the scene."""
INDEPENDENCE_TOGETHER = 0.3
"""Weight of an aligned match among several pairs: errors of different pairs do not correlate."""
AGREEMENT_TOGETHER = 0.05
"""Largest error in x/z, y/z at which a match agrees with cameras that come from aligned pairs."""


@one_thread()
@torch.no_grad()
def solve_views(
    pairs: list[PairMatches],
    views: PhotoViews,
    settings: SolveSettings,
) -> SolvedViews:
    """Cameras, focal length and depth corrections that fit all matches best.

    1. Register the pair, or with more than two views every pair on its own: one wrong pair would
       spoil the others. Chain the pairs that fit best along a spanning tree.
    2. Align the matches with the current cameras, then adjust cameras and depths of all views
       together; repeat. Better cameras give better matches, and better matches better cameras.

    Not differentiable.

    Args:
        pairs: Matches of enough pairs to connect all views.
        views: Photos and predicted geometry. The cameras come out in units of the depths.
        settings: What is solved for, and the expected errors of the depths.
    """
    if not pairs:
        first = torch.eye(4).to(views.depths).expand(*views.depths.shape[:2], 4, 4)
        return initial_solution(views, first.clone())
    subset = subsample_matches(pairs, views)
    if len(pairs) == 1:
        solved = _adjust(
            subset, views, initial_solution(views, _register(pairs[0], views)), settings
        )
    else:
        solved = initial_solution(views, _chain_pairs(pairs, views, settings))
    for matches in [subset] * SUBSAMPLED_ROUNDS + [pairs] * FULL_ROUNDS:
        solved = improve_views(matches, views, solved, settings)
    return solved


def initial_solution(
    views: PhotoViews, cam_from_first: Float[Tensor, "batch view 4 4"]
) -> SolvedViews:
    """These cameras, without a correction of depths or focal length."""
    zeros = torch.zeros_like(views.depths)
    return SolvedViews(cam_from_first, zeros[:, 0, 0, 0], zeros)


@one_thread()
@torch.no_grad()
def improve_views(
    pairs: list[PairMatches], views: PhotoViews, solved: SolvedViews, settings: SolveSettings
) -> SolvedViews:
    """One more round: matches aligned with the current solution, then all views adjusted.

    Args:
        pairs: Matches before any alignment, all or a subset.
        views: As in `solve_views`.
        solved: The current solution.
        settings: As in `solve_views`; the expected errors are of the depths in `views`.
    """
    if not pairs:
        return solved
    aligned = align_pairs(pairs, views.corrected(solved), solved.cam_from_first)
    if len(pairs) > 1:
        noise = replace(
            settings.noise, independence=INDEPENDENCE_TOGETHER, agreement=AGREEMENT_TOGETHER
        )
    else:  # a single pair has no other to contradict it
        noise = replace(settings.noise, independence=INDEPENDENCE_ALONE)
    return _adjust(aligned, views, solved, replace(settings, noise=noise))


@one_thread()
def align_pairs(
    pairs: list[PairMatches], views: PhotoViews, cam_from_first: Float[Tensor, "batch view 4 4"]
) -> list[PairMatches]:
    """All matches aligned photometrically, from the positions that cameras and depth predict."""
    if not pairs:
        return []
    ways = Ways.of(pairs, len(views.depths))
    here, there = (views.at(ways.scenes, each, cam_from_first) for each in (ways.here, ways.there))
    return replace(ways, matches=align_matches(ways.matches, here, there)).to_pairs(pairs)


def _adjust(
    pairs: list[PairMatches], views: PhotoViews, solved: SolvedViews, settings: SolveSettings
) -> SolvedViews:
    height, width = views.depths.shape[-2:]
    grid = coarse_grid(height, width)
    observations = pair_observations(pairs, views)
    cam_from_first, corrections, log_focal = adjust_bundle(
        observations, solved.cam_from_first, settings, grid, log_focal=solved.log_focal
    )
    dense = functional.interpolate(
        corrections.unflatten(-1, grid), size=(height, width), mode="bilinear", align_corners=False
    )
    return SolvedViews(cam_from_first, log_focal, dense)


def _register(pair: PairMatches, views: PhotoViews) -> Float[Tensor, "batch 2 4 4"]:
    """cam_from_first of the two views of a pair, from matched descriptors and depth."""
    cells = matched_cells(Ways.of([pair], len(views.depths)), views)
    b_from_a = register_pair(*cells.split(2))
    return torch.stack([torch.eye(4).to(b_from_a).expand_as(b_from_a), b_from_a], dim=1)


def _chain_pairs(
    pairs: list[PairMatches], views: PhotoViews, settings: SolveSettings
) -> Float[Tensor, "batch view 4 4"]:
    """cam_from_first of every view, composed from the pairs with the most support."""
    batch, count = views.depths.shape[:2]
    # 1. Solve every pair of every scene on its own, all in one batch.
    pair, scenes, both = _as_scenes(pairs, batch)
    two_views = PhotoViews(
        views.images[scenes, both], views.depths[scenes, both], views.intrinsics[scenes, both]
    )
    settings = SolveSettings(settings.depth_is_free[scenes, both], noise=settings.noise)
    subset = subsample_matches([pair], two_views)
    registered = initial_solution(two_views, _register(pair, two_views))
    solved = _adjust(subset, two_views, registered, settings)
    for _ in range(ROUNDS_ALONE):
        solved = improve_views(subset, two_views, solved, settings)
    # 2. In each scene, chain the pairs along the spanning tree of the most support.
    support = match_support(subset, two_views, solved, settings.noise).view(-1, batch)
    b_from_a = solved.cam_from_first[:, 1].unflatten(0, (-1, batch))
    found = []
    for scene in range(batch):
        edges = [(int(p.views_a[scene]), int(p.views_b[scene])) for p in pairs]
        scores = views.depths.new_full((count, count), -1.0)  # below every pair that exists
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
    """All pairs as one batch of scenes of two views, with their scene and views as indices."""
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


@one_thread()
def match_support(
    pairs: list[PairMatches], views: PhotoViews, solved: SolvedViews, noise: BundleNoise
) -> Float[Tensor, " batch"]:
    """Robust number of aligned matches that fit the cameras; wrong cameras have few.

    Args:
        pairs: Matches before any alignment.
        views: With the depths and intrinsics that `solved` corrects.
        solved: The cameras.
        noise: Expected errors.
    """
    views = views.corrected(solved)
    aligned = align_pairs(pairs, views, solved.cam_from_first)
    observations = pair_observations(aligned, views)
    there, here = (
        solved.cam_from_first[observations.scenes, view]
        for view in (observations.there, observations.here)
    )
    seen = transform_points(there @ invert_rigid(here), observations.points)
    error = seen[..., :2] / seen[..., 2:].clamp_min(NEAREST) - observations.rays
    squared = (error[..., None, :] @ observations.precision @ error[..., None])[..., 0, 0]
    weight = confidence_weight(observations.confidence) / (1 + squared / noise.outlier**2)
    return squared.new_zeros(len(views.depths)).index_add(0, observations.scenes, weight.sum(-1))
