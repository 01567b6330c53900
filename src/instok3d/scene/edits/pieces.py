"""How an object falls apart: into connected pieces, or by a box."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from instok3d.scene.objects import SceneObject
from instok3d.scene.record import SceneRecord
from instok3d.types import Gaussians

MIN_SHARE = 0.02
"""Of an object's opacity that a connected piece needs to become an object: less is a crumb."""
GAP_SHARE = 0.05
"""Of the longest side of an object's box: pieces that are nearer than this are connected."""
FAINT = 0.05
"""Gaussians of less opacity connect nothing; they go with the nearest one that does."""


def connected_pieces(gaussians: Gaussians, gap: float) -> Int[Tensor, " gaussian"]:
    """The piece of each Gaussian, 0 for the heaviest; crumbs belong to the nearest piece.

    1. Centres fall into cubes of half a gap; cubes that touch, at corners too, are connected.
    2. Pieces of less than MIN_SHARE of the opacity are crumbs.
    3. Crumbs and faint Gaussians go to the piece of the nearest centre.

    Args:
        gaussians: Unbatched, at least one.
        gap: Along an axis, centres farther apart than this are not connected, scene units.
    """
    means, opacities = gaussians.means.double(), gaussians.opacities.double()
    solid = opacities >= FAINT
    if not solid.any():
        return torch.zeros(len(means), dtype=torch.long)
    cubes = ((means[solid] - means[solid].min(dim=0).values) / (gap / 2)).floor().long()
    places, cube_of = cubes.unique(dim=0, return_inverse=True)
    piece = _components(places)[cube_of]
    weight = torch.zeros(int(piece.max()) + 1, dtype=torch.float64)
    weight.index_add_(0, piece, opacities[solid])
    order = weight.argsort(descending=True, stable=True)
    large = weight[order] >= MIN_SHARE * weight.sum()
    rank = torch.full_like(order, -1)
    rank[order[large]] = torch.arange(int(large.sum()))
    pieces = torch.full((len(means),), -1, dtype=torch.long)
    pieces[solid] = rank[piece]
    known = (pieces >= 0).nonzero()[:, 0]
    for rows in (pieces < 0).nonzero()[:, 0].split(1024):
        nearest = torch.cdist(means[rows], means[known]).argmin(dim=1)
        pieces[rows] = pieces[known[nearest]]
    return pieces


def _components(places: Int[Tensor, "cube 3"]) -> Int[Tensor, " cube"]:
    """Number of the connected component of each cube: the smallest number among touching ones."""
    cubes = [tuple(place) for place in places.tolist()]
    index = {place: number for number, place in enumerate(cubes)}
    label = [-1] * len(index)
    count = 0
    for first in range(len(label)):
        if label[first] >= 0:
            continue
        label[first], border = count, [first]
        while border:
            x, y, z = cubes[border.pop()]
            for i in (x - 1, x, x + 1):
                for j in (y - 1, y, y + 1):
                    for k in (z - 1, z, z + 1):
                        other = index.get((i, j, k))
                        if other is not None and label[other] < 0:
                            label[other] = count
                            border.append(other)
        count += 1
    return torch.tensor(label)


def gap_of(item: SceneObject) -> float:
    """The gap between pieces of an object unless another is given, scene units."""
    return max(GAP_SHARE * max(item.obb.size), 1e-9)


def inside_box(
    scene: SceneRecord, item: SceneObject, low: Sequence[float], high: Sequence[float]
) -> Bool[Tensor, " gaussian"]:
    """Which Gaussians of an object have their anchor in a box along the axes of the world.

    Of an object with one anchor, as in imported scenes, the Gaussians' own centres count.
    """
    start, count = item.gaussian_range
    own = scene.gaussians.rows(slice(start, start + count))
    single = len(own.anchor_index.unique()) == 1
    places = own.means if single else scene.tokens.positions[own.anchor_index]
    least, most = torch.tensor(low).to(places), torch.tensor(high).to(places)
    return ((places >= least) & (places <= most)).all(dim=1)
