"""The similarity between two captures by marks that look alike: of the whole room, not its objects.

1. Triples of matched marks propose similarities; the one that most matches fit is taken (RANSAC).
2. It is fitted to the matches that agree, then to these and the surfaces' points together.
"""

from dataclasses import replace

import torch
from jaxtyping import Float
from scipy.spatial import KDTree
from torch import Tensor

from instok3d.scene.changes.alignment import (
    AT_ONCE,
    NEAR,
    Alignment,
    fit_similarity,
    measured,
    similarity,
    with_colors,
)
from instok3d.scene.changes.marks import matched
from instok3d.scene.changes.traits import Traits

TRIALS, FITS, STEPS = 3000, 10, 12
"""Triples that are tried, fits to the matches, fits to matches and points."""
AGREE = 0.08
"""In radii of the room: how far matched marks may lie apart. The median error of depth of two
photos is 0.05 of it."""
LEAST = 14
"""Matches that must agree. Of 22 pairs of different rooms the best similarity had 4 to 11."""
SHARE = 0.5
"""Weight of the matches, in weights of the points."""
SCALES = (0.2, 5.0)
"""Between which the scale may be: photos of one room give like units."""

Fit = tuple[Float[Tensor, "3 3"], Float[Tensor, "3"], Float[Tensor, ""]]


def align_marks(first: Traits, second: Traits, *, seed: int = 0) -> Alignment:
    """The alignment of two captures of one room whose marks are comparable.

    Args:
        first: Of the capture that is carried along.
        second: Of the capture in whose world it is laid.
        seed: Of the triples.

    Raises:
        ValueError: Too few matches agree.
    """
    rows = matched(first.marks, second.marks)
    source, target = first.marks.positions[rows[:, 0]], second.marks.positions[rows[:, 1]]
    radius = max(second.radius, 1e-12)
    found = None
    if len(rows) >= LEAST:
        found = _fitted(source, target, _proposed(source, target, radius, seed), radius)
    agreed = 0 if found is None else _agreeing(source, target, found, radius)
    if found is None or agreed < LEAST:
        raise ValueError(
            f"no alignment of the two scenes can be trusted: {agreed} of {len(rows)} places that "
            f"look alike agree, where {LEAST} are wanted; give two captures of one room that show "
            "much of the same"
        )
    found = _on_surfaces(first, second, source, target, found)
    return replace(measured(first, second, similarity(*found)), matches=agreed)


def _apart(source: Tensor, target: Tensor, found: Fit) -> Float[Tensor, " match"]:
    rotation, translation, scale = found
    return (scale * source @ rotation.mT + translation - target).norm(dim=1)


def _agreeing(source: Tensor, target: Tensor, found: Fit, radius: float) -> int:
    return int((_apart(source, target, found) < AGREE * radius).sum())


def _proposed(
    source: Float[Tensor, "match 3"], target: Float[Tensor, "match 3"], radius: float, seed: int
) -> Fit:
    generator = torch.Generator().manual_seed(seed)
    triples = torch.randint(len(source), (TRIALS, 3), generator=generator)
    fits = fit_similarity(source[triples], target[triples], torch.ones(TRIALS, 3).double())
    together = max(1, AT_ONCE // (3 * len(source)))
    scores = []
    for rotation, translation, scale in zip(*(each.split(together) for each in fits), strict=True):
        moved = scale[:, None, None] * (source @ rotation.mT) + translation[:, None]
        far = (moved - target).norm(dim=2) / (AGREE * radius)
        sound = (scale > SCALES[0]) & (scale < SCALES[1])
        scores.append((1 - far**2).clamp_min(0).sum(dim=1) * sound)
    best = int(torch.cat(scores).argmax())
    return fits[0][best], fits[1][best], fits[2][best]


def _weights(source: Tensor, target: Tensor, found: Fit, radius: float) -> Float[Tensor, " match"]:
    """Tukey's: none beyond twice the distance that agrees."""
    far = _apart(source, target, found) / (2 * AGREE * radius)
    return (1 - far**2).clamp_min(0) ** 2


def _fitted(source: Tensor, target: Tensor, found: Fit, radius: float) -> Fit:
    for _ in range(FITS):
        found = fit_similarity(source, target, _weights(source, target, found, radius))
    return found


def _on_surfaces(first: Traits, second: Traits, source: Tensor, target: Tensor, found: Fit) -> Fit:
    """Fitted to matches, and to points that lie near a surface of like colour."""
    radius = max(second.radius, 1e-12)
    tree = KDTree(with_colors(second.points, second, radius).numpy())
    for step in range(STEPS):
        reach = max(NEAR, 2 * NEAR * (1 - step / 8))
        moved = similarity(*found).points(first.points)
        near, index = tree.query(
            with_colors(moved, first, radius).numpy(), distance_upper_bound=reach, workers=1
        )
        kept = torch.from_numpy(near < reach)
        weights = (-((torch.from_numpy(near)[kept] / reach) ** 2)).exp()
        of_marks = _weights(source, target, found, radius)
        of_marks = of_marks * SHARE * weights.sum() / of_marks.sum().clamp_min(1e-9)
        if not len(weights):
            return found
        found = fit_similarity(
            torch.cat([first.points[kept], source]),
            torch.cat([second.points[torch.from_numpy(index)[kept]], target]),
            torch.cat([weights, of_marks]),
        )
    return found
