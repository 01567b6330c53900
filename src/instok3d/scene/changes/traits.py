"""What is compared of two captures: points with colours, and of each object its look and size."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from instok3d.geometry.spherical_harmonics import SH_CONSTANT
from instok3d.rooms.seen_colors import LIGHTNESS_WEIGHT, lab
from instok3d.scene.changes.marks import Marks, marks_of
from instok3d.scene.objects import SceneObject
from instok3d.scene.record import SceneRecord

SOLID = 0.3
"""Opacity from which on a Gaussian counts as surface."""
MOST_POINTS = 400
"""Of each object and, tenfold, of the rest that belongs to none."""
COLOR_SPREAD, SHAPE_SPREAD, COSINE_SPREAD = 14.0, 0.35, 0.25
"""Differences that two captures of one thing have: of colour (Lab, lightness counting half), of
the logarithms of its sides, of one minus the cosine of embeddings."""


@dataclass(frozen=True)
class Traits:
    """A capture as comparisons look at it."""

    objects: tuple[SceneObject, ...]
    """Those that are not hidden."""
    centers: Float[Tensor, "object 3"]
    """Centroids."""
    extents: Float[Tensor, "object 3"]
    """Sides of the oriented boxes, longest first."""
    colors: Float[Tensor, "object 3"]
    """Mean, Lab with less lightness."""
    embeddings: dict[str, Float[Tensor, "object feature"]]
    """Unit vectors by encoder; zeros where nothing is known."""
    points: Float[Tensor, "point 3"]
    """Centres of solid Gaussians of all that is drawn."""
    point_colors: Float[Tensor, "point 3"]
    owners: Int[Tensor, " point"]
    """Row of each point's object; the number of objects for what belongs to none."""
    spacing: Float[Tensor, " point"]
    """Median distance of neighbours among the points of the same object, scene units."""
    marks: Marks
    """Places with a look of their own, by the model."""

    @property
    def radius(self) -> float:
        """Median distance of the points from their median, scene units: how large the room is."""
        if not len(self.points):
            return 0.0
        middle = self.points.median(dim=0).values
        return float((self.points - middle).norm(dim=1).median())

    def of_object(self, row: int) -> Bool[Tensor, " point"]:
        """Which points are of an object."""
        return self.owners == row


@torch.no_grad()
def traits_of(scene: SceneRecord) -> Traits:
    """The traits of a scene; the same for the same scene."""
    drawn = tuple(item for item in scene.objects if not item.hidden)
    gaussians = scene.gaussians.map(lambda value: value.detach().cpu())
    hues = weighted_lab(gaussians.sh[:, 0].double() * SH_CONSTANT + 0.5)
    solid = gaussians.opacities >= SOLID
    colors = torch.zeros(len(drawn), 3, dtype=torch.float64)
    chosen, owners, end = [], [], sum(item.num_gaussians for item in scene.objects)
    for row, item in enumerate(drawn):
        start, count = item.gaussian_range
        rows = torch.arange(start, start + count)
        weight = gaussians.opacities[rows].double().clamp_min(1e-6)[:, None]
        colors[row] = (weight * hues[rows]).sum(dim=0) / weight.sum()
        chosen.append(_thinned(rows[solid[rows]], MOST_POINTS))
        owners += [row] * len(chosen[-1])
    rest = torch.arange(end, len(gaussians.means))
    chosen.append(_thinned(rest[solid[rest]], 10 * MOST_POINTS))
    owners += [len(drawn)] * len(chosen[-1])
    index = torch.cat(chosen)
    ids = [item.id for item in drawn]
    return Traits(
        objects=drawn,
        centers=_rows([item.centroid for item in drawn]),
        extents=_rows([sorted(item.obb.size, reverse=True) for item in drawn]).clamp_min(1e-9),
        colors=colors,
        embeddings={
            name: one.of_objects(ids, scene.tokens.assignment).double()
            for name, one in scene.semantics.items()
        },
        points=gaussians.means[index].double(),
        point_colors=hues[index],
        owners=torch.tensor(owners, dtype=torch.long),
        spacing=torch.cat([_spacing(gaussians.means[rows].double()) for rows in chosen]),
        marks=marks_of(scene, drawn),
    )


def unlikeness(
    first: Traits, second: Traits, scale: float | None = None
) -> Float[Tensor, "object other"]:
    """How little each object of one capture looks like each of another; 1 is usual for the same.

    Args:
        first: Of one capture.
        second: Of another one.
        scale: Length of the second's units in one of the first's, where sizes are to agree; None
            compares their proportions alone.
    """
    parts = [(first.colors[:, None] - second.colors[None]).norm(dim=2) / COLOR_SPREAD]
    sides = first.extents.log()[:, None] - second.extents.log()[None]
    if scale is None:
        sides = sides - sides.mean(dim=2, keepdim=True)
    else:
        sides = sides + float(np.log(scale))
    parts.append(sides.square().mean(dim=2).sqrt() / SHAPE_SPREAD)
    for name in first.embeddings.keys() & second.embeddings.keys():
        one, other = first.embeddings[name], second.embeddings[name]
        if one.shape[1] == other.shape[1]:
            both = one.any(dim=1)[:, None] & other.any(dim=1)[None]
            parts.append(torch.where(both, (1 - one @ other.T) / COSINE_SPREAD, 1.0))
    return torch.stack(parts).square().mean(dim=0).sqrt()


def weighted_lab(colors: Float[Tensor, "*pixel 3"]) -> Float[Tensor, "*pixel 3"]:
    """Lab of sRGB colours in [0, 1], lightness counting less."""
    values = torch.from_numpy(lab(colors.double().clamp(0, 1).numpy()))
    return values * torch.tensor([LIGHTNESS_WEIGHT, 1.0, 1.0]).double()


def _spacing(points: Float[Tensor, "point 3"]) -> Float[Tensor, " point"]:
    """The median distance of a point to its nearest neighbour, for each point."""
    if len(points) < 2:
        return torch.zeros(len(points), dtype=torch.float64)
    distance, _ = KDTree(points.numpy()).query(points.numpy(), k=2)
    return torch.full((len(points),), float(np.median(distance[:, 1])), dtype=torch.float64)


def _thinned(rows: Int[Tensor, " row"], most: int) -> Int[Tensor, " chosen"]:
    """At most so many of the rows, evenly among them."""
    if len(rows) <= most:
        return rows
    return rows[torch.linspace(0, len(rows) - 1, most, dtype=torch.float64).round().long()]


def _rows(values: list) -> Float[Tensor, "object 3"]:
    return torch.tensor(values, dtype=torch.float64).reshape(-1, 3)
