"""Whether the things of one capture still stand where they stood, as another capture sees it.

Every point of an object is looked for in the pictures of the other capture's cameras: whether what
is drawn there has its depth and colour, which object that is, and whether the model sees there
what it saw before. What is not in a picture, or behind something, says nothing.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from scipy.spatial import KDTree
from torch import Tensor

from instok3d.scene.changes.eyes import Eyes, Look
from instok3d.scene.changes.traits import COLOR_SPREAD, Traits

AROUND = 2
"""Pixels of 128 in either direction in which a point is looked for."""
DEPTH_SPREAD = 0.25
"""Difference of the logarithms of depths that weighs as much as one of COLOR_SPREAD in colour.
Loose, since two photos give depth with errors that are not smooth alone."""
MOST_UNLIKE = 4.0
HIDDEN = 0.1
"""A point is hidden where most of what is drawn around it is nearer by this logarithm."""
FEW = 200
"""Points of each object that are looked for."""
REACH = 0.25
"""In radii of the room: where a mark's like may lie for the place to look as it did."""
SAME_PLACE = 0.05
"""In radii of the room: points so near show one surface, whose colour both captures know."""
LEAST_SHARED = 50
"""Points of one surface from which on the difference of exposures is known."""


@dataclass(frozen=True)
class Sighting:
    """What the other capture shows where an object was."""

    seen: float
    """Share of its points that are in a picture and not hidden, [0, 1]."""
    unlike: float
    """Mean difference of depth and colour of these points, [0, MOST_UNLIKE]; 1 is usual."""
    marks: float
    """Mean cosine of its marks there and their nearest like around them, [0, 1]."""
    occupant: float
    """How much what stands there looks like it (`likeness.looks_alike`), mean of these points."""
    shares: dict[int, float]
    """Of these points, by the id of the other capture's object that is there, 0 for none."""

    @property
    def absent(self) -> float:
        """Probability that it is not there, of half of the objects; see ABSENT."""
        values = (self.unlike, self.marks, self.occupant, 1.0)
        return 1 / (1 + math.exp(-sum(a * b for a, b in zip(ABSENT, values, strict=True))))


ABSENT = (1.05, -1.7, -3.8, 1.6)
"""Weights of `unlike`, `marks` and `occupant`, and the constant: near those of a logistic
regression on the objects of training rooms (docs/log.md)."""


def colors_between(first: Traits, second: Traits) -> Float[Tensor, "3"]:
    """What is added to colours of the first for the second's exposure, both in one world."""
    if not len(second.points):
        return torch.zeros(3, dtype=torch.float64)
    distance, index = KDTree(second.points.numpy()).query(
        first.points.numpy(), distance_upper_bound=SAME_PLACE * second.radius
    )
    near = torch.from_numpy(distance < math.inf)
    if int(near.sum()) < LEAST_SHARED:
        return torch.zeros(3, dtype=torch.float64)
    there = second.point_colors[torch.from_numpy(index)[near]]
    return (there - first.point_colors[near]).median(dim=0).values


def sightings(
    first: Traits,
    second: Traits,
    eyes: Eyes,
    likes: Float[Tensor, "object other"],
    colors: Float[Tensor, "3"],
) -> list[Sighting]:
    """What the second capture's cameras see in the places of the first one's objects.

    Args:
        first: In the second's world.
        second: Whose cameras look.
        eyes: What they show.
        likes: How much the objects look like each other.
        colors: What is added to the first's colours for the second's exposure.
    """
    scene = eyes.scene
    looks = eyes.looked_at(first.points)
    biases = [each.bias(scene.height, scene.width) for each in looks]
    marks = _marks(first, second, eyes)
    by_id = torch.zeros(len(first.objects), int(eyes.ids.max()) + 1, dtype=torch.float64)
    for column, item in enumerate(second.objects):
        if item.id < by_id.shape[1]:
            by_id[:, item.id] = likes[:, column]
    found = []
    for row in range(len(first.objects)):
        rows = first.of_object(row).nonzero()[:, 0]
        rows = rows[:: max(1, len(rows) // FEW)]
        wanted = first.point_colors[rows] + colors
        seen, unlike, ids = _points(
            eyes, [(each.of(rows), bias[rows]) for each, bias in zip(looks, biases, strict=True)],
            wanted,
        )  # fmt: skip
        own = ids[seen]
        count = own.bincount(minlength=1)
        found.append(Sighting(
            seen=float(seen.double().mean()) if len(seen) else 0.0,
            unlike=float(unlike[seen].mean()) if len(own) else MOST_UNLIKE,
            marks=marks[row],
            occupant=float(by_id[row][own].mean()) if len(own) else 0.0,
            shares={number: float(count[number]) / len(own)
                    for number in count.nonzero()[:, 0].tolist()},
        ))  # fmt: skip
    return found


def _points(
    eyes: Eyes, looks: list[tuple[Look, Float[Tensor, " point"]]], wanted: Float[Tensor, "point 3"]
) -> tuple[Tensor, Tensor, Tensor]:
    """Whether a view sees each point, its least difference, and the id where depth is best."""
    count, scene = len(wanted), eyes.scene
    steps = torch.arange(-around(scene.width), around(scene.width) + 1)
    seen = torch.zeros(count, dtype=torch.bool)
    unlike = torch.full((count,), MOST_UNLIKE, dtype=torch.float64)
    nearest, ids = torch.full_like(unlike, math.inf), torch.zeros(count, dtype=torch.long)
    for look, bias in looks:
        y = (look.y[:, None, None] + steps[:, None]).clamp(0, scene.height - 1)
        x = (look.x[:, None, None] + steps).clamp(0, scene.width - 1)
        shown = eyes.depths[look.view][y, x].flatten(1).clamp_min(1e-12)
        colors = eyes.colors[look.view][y, x].flatten(1, 2)
        gaps = (shown / look.z.clamp_min(1e-12)[:, None]).log() - bias[:, None]
        apart = (colors - wanted[:, None]).norm(dim=2) / COLOR_SPREAD
        here = look.inside & (gaps.median(dim=1).values >= -HIDDEN)
        cost = ((gaps / DEPTH_SPREAD) ** 2 + apart**2).sqrt().amin(dim=1)
        unlike = torch.where(here, unlike.minimum(cost), unlike)
        gap = gaps.abs().amin(dim=1)
        better = here & (gap < nearest)
        ids = torch.where(better, eyes.ids[look.view][look.y, look.x], ids)
        nearest = torch.where(better, gap, nearest)
        seen |= here
    return seen, unlike, ids


def around(width: int) -> int:
    """AROUND in pixels of a picture of some width."""
    return max(1, round(AROUND * width / 128))


def _marks(first: Traits, second: Traits, eyes: Eyes) -> list[float]:
    own, other = first.marks, second.marks
    seen = torch.zeros(len(own.positions), dtype=torch.bool)
    for look in eyes.looked_at(own.positions):
        seen |= look.inside & (look.ratio > -HIDDEN)
    near = torch.cdist(own.positions, other.positions) < REACH * second.radius
    best = torch.where(near, own.looks @ other.looks.mT, 0.0).amax(dim=1).clamp_min(0)
    values = []
    for row in range(len(first.objects)):
        rows = seen & (own.owners == row)
        values.append(float(best[rows].mean()) if rows.any() else 0.0)
    return values
