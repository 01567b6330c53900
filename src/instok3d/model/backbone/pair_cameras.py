"""Relative cameras from the matches of pairs of views, and their chain to the first view."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from instok3d.geometry.cameras import pixel_rays
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
def solve_pairs(
    matches: list[PairMatches],
    depths: Float[Tensor, "batch view height width"],
    intrinsics: Float[Tensor, "batch view 3 3"],
) -> list[Float[Tensor, "batch 4 4"]]:
    """b_from_a of each pair, in units of the depths; not differentiable."""
    solved = []
    for pair in matches:
        a, b = matched_points(pair, depths, intrinsics)
        solved.append(
            register_pair(
                a.points, a.rays, a.matched, a.trust, b.points, b.rays, b.matched, b.trust
            )
        )
    return solved


def chain_cameras(
    matches: list[PairMatches],
    b_from_a: list[Float[Tensor, "batch 4 4"]],
    *,
    batch: int,
) -> Float[Tensor, "batch view 4 4"]:
    """cam_from_first of every view: the relative cameras, composed along the tree of pairs.

    Args:
        matches: One pair fewer than there are views; view b of each is first reached by it.
        b_from_a: The camera of each pair.
        batch: Number of scenes, for views without any pair.
    """
    scenes = []
    for scene in range(batch):
        edges = [(int(pair.views_a[scene]), int(pair.views_b[scene])) for pair in matches]
        steps = {edge: step[scene] for edge, step in zip(edges, b_from_a, strict=True)}
        scenes.append(compose_along_tree(steps, edges))
    return torch.stack(scenes)


def cell_rays(
    intrinsics: Float[Tensor, "batch 3 3"], height: int, width: int
) -> Float[Tensor, "batch row column 3"]:
    """Rays through the centres of the descriptor cells, z = 1, in each camera's frame."""
    scaled = intrinsics.clone()
    scaled[:, :2] = scaled[:, :2] / MATCH_STRIDE
    return pixel_rays(scaled, height // MATCH_STRIDE, width // MATCH_STRIDE)
