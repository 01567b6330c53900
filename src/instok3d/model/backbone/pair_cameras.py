"""Cameras of all views from the matches of pairs of them, and what the matches say of depth."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from instok3d.geometry.bundle import BundleNoise, Sightings, adjust_bundle, coarse_grid
from instok3d.geometry.cameras import pixel_centers, pixel_rays
from instok3d.geometry.registration import compose_along_tree, register_pair
from instok3d.model.backbone.matching import Peaks

MATCH_STRIDE = 4
"""Pixels between neighbouring descriptors."""


@dataclass(frozen=True)
class PairMatches:
    """Matches of two views of each scene of the batch, both ways."""

    views_a: Int[Tensor, " batch"]
    views_b: Int[Tensor, " batch"]
    peaks_a: Peaks
    """Where the cells of a lie in b."""
    peaks_b: Peaks
    """Where the cells of b lie in a."""


@dataclass(frozen=True)
class ViewMatches:
    """Which pairs of views were matched."""

    tree: list[PairMatches]
    """One pair fewer than there are views; view b of each is first reached by it."""
    loops: list[PairMatches]
    """More pairs that see much of the same."""

    @property
    def pairs(self) -> list[PairMatches]:
        """Both."""
        return self.tree + self.loops


@dataclass(frozen=True)
class SolvedViews:
    """Cameras of all views and the coarse change of their depths."""

    cam_from_first: Float[Tensor, "batch view 4 4"]
    """In units of the depths."""
    deeper: Float[Tensor, "batch view height width"]
    """To be added to log depth."""


@dataclass(frozen=True)
class MatchedPoints:
    """Cells of one view in space, and where another view sees them: one direction of a pair."""

    points: Float[Tensor, "batch cell 3"]
    """Where the depth puts each cell, in its own camera's frame."""
    rays: Float[Tensor, "batch cell 2"]
    """x/z, y/z of its match in the other camera's frame."""
    matched: Float[Tensor, "batch cell 3"]
    """Where the other view's depth puts the match, in the other camera's frame."""
    trust: Float[Tensor, "batch cell"]
    """Probability of the match."""


def matched_points(
    pair: PairMatches,
    depths: Float[Tensor, "batch view height width"],
    intrinsics: Float[Tensor, "batch view 3 3"],
) -> tuple[MatchedPoints, MatchedPoints]:
    """The cells of a as b sees them, and the cells of b as a sees them."""
    scenes = torch.arange(len(depths), device=depths.device)
    points, rays = [], []
    for views in (pair.views_a, pair.views_b):
        coarse = functional.avg_pool2d(depths[scenes, views, None].log(), MATCH_STRIDE)[:, 0].exp()
        directions = cell_rays(intrinsics[scenes, views], depths.shape[-2], depths.shape[-1])
        points.append((directions * coarse[..., None]).flatten(1, 2))
        rays.append(directions[..., :2].flatten(1, 2))
    a, b = (
        MatchedPoints(points[here], peaks.mean(rays[there]), peaks.mean(points[there]), peaks.trust)
        for here, there, peaks in ((0, 1, pair.peaks_a), (1, 0, pair.peaks_b))
    )
    return a, b


@torch.no_grad()
def solve_views(
    matches: ViewMatches,
    depths: Float[Tensor, "batch view height width"],
    intrinsics: Float[Tensor, "batch view 3 3"],
    *,
    depth_is_free: Float[Tensor, "batch view"],
    noise: BundleNoise,
) -> SolvedViews:
    """The cameras under which all matches fit best, and depth moved with them.

    Pairs along the tree are solved alone and chained; from there all views and pairs are adjusted
    together. Not differentiable.

    Args:
        matches: Of all views.
        depths: > 0; the cameras come out in their units.
        intrinsics: Pixels.
        depth_is_free: 1 for views whose depth may change, 0 where it is known.
        noise: What to expect of matches and depths.
    """
    ways = [matched_points(pair, depths, intrinsics) for pair in matches.pairs]
    start = _chain(matches.tree, ways, batch=len(depths)).to(depths)
    height, width = depths.shape[-2:]
    grid = coarse_grid(height, width)
    if not ways:
        return SolvedViews(start, torch.zeros_like(depths))
    sightings = _sightings(matches.pairs, ways, height, width)
    cam_from_first, changes = adjust_bundle(sightings, start, depth_is_free, grid, noise=noise)
    deeper = functional.interpolate(
        changes.unflatten(-1, grid), size=(height, width), mode="bilinear", align_corners=False
    )
    return SolvedViews(cam_from_first, deeper)


def _chain(
    tree: list[PairMatches], ways: list[tuple[MatchedPoints, MatchedPoints]], *, batch: int
) -> Float[Tensor, "batch view 4 4"]:
    """cam_from_first of every view: each pair of the tree solved alone, composed along it."""
    b_from_a = [
        register_pair(a.points, a.rays, a.matched, a.trust, b.points, b.rays, b.matched, b.trust)
        for a, b in ways[: len(tree)]
    ]
    scenes = []
    for scene in range(batch):
        edges = [(int(pair.views_a[scene]), int(pair.views_b[scene])) for pair in tree]
        steps = {edge: step[scene] for edge, step in zip(edges, b_from_a, strict=True)}
        scenes.append(compose_along_tree(steps, edges))
    return torch.stack(scenes)


def _sightings(
    pairs: list[PairMatches],
    ways: list[tuple[MatchedPoints, MatchedPoints]],
    height: int,
    width: int,
) -> Sightings:
    """Both directions of every pair of every scene, one row each, from every second cell.

    Matches of neighbouring cells are wrong together: all of them say little more than a quarter.
    """
    rows, columns = height // MATCH_STRIDE, width // MATCH_STRIDE
    chosen = torch.arange(rows * columns).view(rows, columns)[::2, ::2].flatten()
    like = ways[0][0].points
    size = torch.tensor([columns, rows]).to(like)
    cells = (pixel_centers(rows, columns, like=like) / size).flatten(0, 1)
    parts = []
    for pair, (a, b) in zip(pairs, ways, strict=True):
        batch = len(pair.views_a)
        scenes = torch.arange(batch, device=like.device)
        places = cells.expand(batch, -1, -1)
        for here, there, way, peaks in (
            (pair.views_a, pair.views_b, a, pair.peaks_a),
            (pair.views_b, pair.views_a, b, pair.peaks_b),
        ):
            of_cells = (way.points, way.rays, way.matched[..., 2], way.trust, places)
            of_cells = (*of_cells, peaks.mean(places))
            parts.append((scenes, here, there, *(each[:, chosen] for each in of_cells)))
    return Sightings(*(torch.cat(each) for each in zip(*parts, strict=True)))


def cell_rays(
    intrinsics: Float[Tensor, "batch 3 3"], height: int, width: int
) -> Float[Tensor, "batch row column 3"]:
    """Rays through the centres of the descriptor cells, z = 1, in each camera's frame."""
    scaled = intrinsics.clone()
    scaled[:, :2] = scaled[:, :2] / MATCH_STRIDE
    return pixel_rays(scaled, height // MATCH_STRIDE, width // MATCH_STRIDE)
