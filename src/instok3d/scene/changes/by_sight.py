"""Changes between two captures of photos, by what the cameras of each see of the other's things.

1. An object whose place the other capture sees is absent there, or not (`sightings`).
2. One that has its like close by is there too, though depth errs.
3. A thing that is absent from its place, and whose like stands where it did not, has moved.
4. What is left absent is gone or new; a part of what moved is told with it.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from instok3d.scene.changes.alignment import Alignment
from instok3d.scene.changes.building import OF_BUILDING, of_building
from instok3d.scene.changes.carrying import carried_by, inverse
from instok3d.scene.changes.eyes import eyes_of
from instok3d.scene.changes.likeness import looks_alike, same_thing, way
from instok3d.scene.changes.record import Change, Kind
from instok3d.scene.changes.sightings import Sighting, colors_between, sightings
from instok3d.scene.changes.traits import Traits
from instok3d.scene.objects import SceneObject

if TYPE_CHECKING:
    from instok3d.scene.scene import Scene

ABSENT, MAYBE, GONE, SURE = 0.4, 0.15, 0.55, 0.9
"""Probabilities of being absent: from which on one of two that are alike must be for both to have
moved, and the other one; from which on what has no like is gone or new; from which on a like close
by does not count, where both are."""
SEEN = 0.4
"""Share of an object's points that must be seen for its place to be known."""
SAME, NEAR_SAME = 0.35, 0.4
"""Probability from which on an object elsewhere, and close by, is taken for the same thing."""
TOLERANCE = 0.2
"""In radii of the room: moves below are not told."""
THERE = 0.3
"""Share of the places of two objects that the other must fill, of both the mean, to be the same."""
PART = "a part of what moved"


@dataclass(frozen=True)
class SightComparison:
    """Two captures with cameras and marks of one model, and their alignment."""

    first: "Scene"
    second: "Scene"
    before: Traits
    after: Traits
    alignment: Alignment

    def changes(self) -> tuple[list[Change], float]:
        """All changes, and the distance up to which objects count as unchanged."""
        move = self.alignment.second_from_first
        before, after = carried_by(self.before, move), self.after
        alike = looks_alike(before, after)
        colors = colors_between(before, after)
        lost = sightings(before, after, eyes_of(self.second), alike, colors)
        found = sightings(
            carried_by(after, inverse(move)), self.before, eyes_of(self.first), alike.T, -colors
        )
        same = same_thing(before, after, alike)
        tolerance = TOLERANCE * after.radius
        return Decision(before, after, lost, found, same, tolerance).changes(), tolerance


@dataclass(frozen=True)
class Decision:
    """What is known of the objects of two captures, in the second one's world."""

    before: Traits
    after: Traits
    lost: list[Sighting]
    """What the second capture shows where the first one's objects were."""
    found: list[Sighting]
    """What the first capture shows where the second one's objects are."""
    same: Float[Tensor, "object other"]
    """Probability that two objects are one thing."""
    tolerance: float
    """Scene units."""

    def changes(self) -> list[Change]:
        """One for each object that changed or is not seen, or for two that are the same."""
        gone, new = _absent(self.before, self.lost), _absent(self.after, self.found)
        ways = self._ways()
        near = self._near(gone, new, ways)
        moved = self._moved(gone, new, ways, near)
        lost = _rows(gone, near[0] | set(moved), GONE)
        fresh = _rows(new, near[1] | set(moved.values()), GONE)
        changes = [self._moving(row, other, ways) for row, other in moved.items()]
        for row in lost:
            likest = max(moved, key=lambda each: float(self.same[row, moved[each]]), default=None)
            if likest is not None and float(self.same[row, moved[likest]]) >= SAME:
                changes.append(self._moving(row, moved[likest], ways, PART))
            else:
                changes.append(Change("gone", self.before.objects[row], None))
        for other in fresh:
            likest = max(moved, key=lambda each: float(self.same[each, other]), default=None)
            if likest is not None and float(self.same[likest, other]) >= SAME:
                changes.append(self._moving(likest, other, ways, PART))
            else:
                changes.append(Change("new", None, self.after.objects[other]))
        told = {id(item) for each in changes for item in (each.before, each.after)}
        return [*changes, *self._others(gone, new, ways, told)]

    def _ways(self) -> Float[Tensor, "object other 3"]:
        ways = torch.zeros(*self.same.shape, 3, dtype=torch.float64)
        for row in range(len(self.before.objects)):
            for other in range(len(self.after.objects)):
                ways[row, other] = way(self.before, self.after, row, other)
        return ways

    def _near(
        self, gone: list[float], new: list[float], ways: Float[Tensor, "object other 3"]
    ) -> tuple[set[int], set[int]]:
        """Rows of both captures that have their like so near that errors of depth explain it."""
        fits = (self.same >= NEAR_SAME) & (ways.norm(dim=2) < self.tolerance)
        pairs = [(row, other) for row, other in fits.nonzero().tolist()
                 if min(gone[row], new[other]) < SURE]  # fmt: skip
        return {row for row, _ in pairs}, {other for _, other in pairs}

    def _moved(
        self,
        gone: list[float],
        new: list[float],
        ways: Float[Tensor, "object other 3"],
        near: tuple[set[int], set[int]],
    ) -> dict[int, int]:
        """For each row that moved the row of what it is in the second capture."""
        rows, others = _rows(gone, near[0], MAYBE), _rows(new, near[1], MAYBE)
        value = torch.zeros(len(rows), len(others), dtype=torch.float64)
        for a, row in enumerate(rows):
            for b, other in enumerate(others):
                far = float(ways[row, other].norm()) >= self.tolerance
                if far and max(gone[row], new[other]) >= ABSENT and self.same[row, other] >= SAME:
                    value[a, b] = self.same[row, other]
        chosen = zip(*linear_sum_assignment(-value.numpy()), strict=True)
        return {rows[a]: others[b] for a, b in chosen if value[a, b] > 0}

    def _moving(
        self, row: int, other: int, ways: Float[Tensor, "object other 3"], note: str = ""
    ) -> Change:
        x, y, z = ways[row, other].tolist()
        return Change("moved", self.before.objects[row], self.after.objects[other], (x, y, z), note)

    def _others(
        self,
        gone: list[float],
        new: list[float],
        ways: Float[Tensor, "object other 3"],
        told: set[int],
    ) -> list[Change]:
        """What did not change, in pairs where two objects fill one place; and what is not seen."""
        first, second = self.before.objects, self.after.objects
        shares = torch.tensor([[each.shares.get(item.id, 0.0) for item in second]
                               for each in self.lost], dtype=torch.float64)  # fmt: skip
        back = torch.tensor([[each.shares.get(item.id, 0.0) for item in first]
                             for each in self.found], dtype=torch.float64)  # fmt: skip
        shares, back = shares.view(len(first), len(second)), back.view(len(second), len(first)).T
        left = [row for row, item in enumerate(first) if id(item) not in told]
        free = [row for row, item in enumerate(second) if id(item) not in told]
        both = (shares + back)[left][:, free]
        changes, paired = [], (set(), set())
        for a, b in zip(*linear_sum_assignment(-both.numpy()), strict=True):
            row, other = left[a], free[b]
            if both[a, b] >= 2 * THERE:
                x, y, z = ways[row, other].tolist()
                changes.append(Change("unchanged", first[row], second[other], (x, y, z)))
                paired[0].add(row)
                paired[1].add(other)
        for row in left:
            if row not in paired[0]:
                kind, note = _unpaired(first[row], self.lost[row], "second")
                changes.append(Change(kind, first[row], None, None, note))
        for row in free:
            if row not in paired[1]:
                kind, note = _unpaired(second[row], self.found[row], "first")
                changes.append(Change(kind, None, second[row], None, note))
        return changes


def _absent(traits: Traits, seen: list[Sighting]) -> list[float]:
    """Probability that each object is absent; below 0 of what cannot be told to be."""
    return [
        -1.0 if of_building(item) or each.seen < SEEN else each.absent
        for item, each in zip(traits.objects, seen, strict=True)
    ]


def _rows(absent: list[float], without: set[int], least: float) -> list[int]:
    return [row for row, value in enumerate(absent) if value >= least and row not in without]


def _unpaired(item: SceneObject, seen: Sighting, other: str) -> tuple[Kind, str]:
    if seen.seen < SEEN:
        return "not seen", f"the {other} scene's cameras do not see its place"
    if of_building(item) and seen.absent >= ABSENT:
        return "not seen", OF_BUILDING
    return "unchanged", f"its place looks the same in the {other} scene"
