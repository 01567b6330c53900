"""Changes between two captures by where their surfaces lie, of any scenes: imported ones too."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import torch
from jaxtyping import Bool, Float
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from instok3d.geometry.cameras import project, transform_points
from instok3d.scene.changes.alignment import Alignment, on_surfaces
from instok3d.scene.changes.building import OF_BUILDING, of_building
from instok3d.scene.changes.carrying import carried_by, inverse
from instok3d.scene.changes.record import Change, Kind
from instok3d.scene.changes.traits import Traits, unlikeness

if TYPE_CHECKING:
    from instok3d.scene.scene import Scene

COVERED = 0.5
"""Share of an object's points on a surface of the other capture from which on it is there too."""
SAME = 1.0
"""Unlikeness up to which an object elsewhere is taken for the same one."""
SIDES = 0.2
"""Difference of the logarithms of their sides up to which both captures show the same of an
object, so that the distance of its centroids is how far it moved."""
OWN = 0.05
"""Share of an object's longest side up to which its centroid moves with what is seen of it."""
SHOWN = 0.4
"""Share of an object's points that must be in sight of the other capture's cameras for it to be
gone or new, and not just not seen."""
HIDDEN_BY = 1.1
"""A point is hidden where what is drawn there is nearer than it by this factor."""


@dataclass(frozen=True)
class SurfaceComparison:
    """Two captures and their alignment."""

    first: "Scene"
    second: "Scene"
    before: Traits
    after: Traits
    alignment: Alignment

    def changes(self) -> tuple[list[Change], float]:
        """All changes, and the distance up to which objects count as unchanged."""
        carried = carried_by(self.before, self.alignment.second_from_first)
        stays, joined = self._staying(carried)
        tolerance = self._tolerance(carried, stays)
        changes = [self._change(carried, row, other, tolerance) for row, other in stays.items()]
        left = [row for row in range(len(carried.objects)) if row not in stays]
        free = [row for row in range(len(self.after.objects)) if row not in stays.values()]
        apart = [row for row in left if row not in joined[0]]
        fresh = [row for row in free if row not in joined[1]]
        moved = self._moving(
            carried,
            [row for row in apart if not of_building(carried.objects[row])],
            [row for row in fresh if not of_building(self.after.objects[row])],
        )
        changes += [
            self._change(carried, row, other, tolerance, True) for row, other in moved.items()
        ]
        changes += [_part(carried, self.after, row, joined[0]) for row in left if row in joined[0]]
        changes += [_part_after(carried, self.after, row, joined[1])
                    for row in free if row in joined[1]]  # fmt: skip
        back = inverse(self.alignment.second_from_first)
        for row in apart:
            if row not in moved:
                changes.append(self._lost(carried.points[carried.of_object(row)], row))
        for row in fresh:
            if row not in moved.values():
                own = self.after.points[self.after.of_object(row)]
                changes.append(self._found(back.points(own), row))
        return changes, tolerance

    def _staying(
        self, carried: Traits
    ) -> tuple[dict[int, int], tuple[dict[int, int], dict[int, int]]]:
        """Which objects are where they were, one for one; and parts of others that are there too.

        An object of one capture may be two of the other one, each of which is covered by it.
        """
        near = self.alignment.near
        forth = _coverage(carried, self.after, near)
        back = _coverage(self.after, carried, near).T
        covered = torch.maximum(forth, back)
        rows, columns = linear_sum_assignment(-(forth * back + 0.01 * covered).numpy())
        stays = {row: column for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
                 if covered[row, column] >= COVERED}  # fmt: skip
        parts = _covered_elsewhere(forth, set(stays))
        others = _covered_elsewhere(back.T, set(stays.values()))
        return stays, (parts, others)

    def _tolerance(self, carried: Traits, stays: dict[int, int]) -> float:
        """Three times the median distance of what stays and is seen alike in both captures."""
        distances = [float((self.after.centers[other] - carried.centers[row]).norm())
                     for row, other in stays.items()
                     if _same_sides(carried, self.after, row, other)]  # fmt: skip
        middle = float(torch.tensor(distances).median()) if distances else 0.0
        return max(3 * middle, self.alignment.near / 2)

    def _moving(self, carried: Traits, left: list[int], free: list[int]) -> dict[int, int]:
        """Pairs of what is left over on both sides that look like the same thing."""
        cost = unlikeness(carried, self.after, 1.0)[left][:, free]
        rows, columns = linear_sum_assignment(cost.numpy())
        return {left[row]: free[column] for row, column in zip(rows, columns, strict=True)
                if cost[row, column] <= SAME}  # fmt: skip

    def _change(
        self, carried: Traits, row: int, other: int, tolerance: float, elsewhere: bool = False
    ) -> Change:
        x, y, z = (self.after.centers[other] - carried.centers[row]).tolist()
        same = elsewhere or _same_sides(carried, self.after, row, other)
        least = max(tolerance, OWN * float(carried.extents[row].max()))
        moved = same and math.hypot(x, y, z) > least
        note = "" if same else "the captures show different parts of it"
        items = carried.objects[row], self.after.objects[other]
        if moved and any(map(of_building, items)):
            moved, note = False, OF_BUILDING
        kind: Kind = "moved" if moved else "unchanged"
        return Change(kind, *items, (x, y, z), note)

    @cached_property
    def _depths(self) -> tuple[Float[Tensor, "view height width"], ...]:
        """What either scene's cameras see, drawn once for all objects."""
        with torch.no_grad():
            return tuple(
                scene.render().depths if scene.views else torch.zeros(0, scene.height, scene.width)
                for scene in (self.first, self.second)
            )

    def _lost(self, points: Float[Tensor, "point 3"], row: int) -> Change:
        if of_building(self.before.objects[row]):
            return Change("not seen", self.before.objects[row], None, None, OF_BUILDING)
        seen = _in_sight(self.second, self._depths[1], points) >= SHOWN
        note = "" if seen else "the second scene's cameras do not see its place"
        return Change("gone" if seen else "not seen", self.before.objects[row], None, None, note)

    def _found(self, points: Float[Tensor, "point 3"], row: int) -> Change:
        if of_building(self.after.objects[row]):
            return Change("not seen", None, self.after.objects[row], None, OF_BUILDING)
        seen = _in_sight(self.first, self._depths[0], points) >= SHOWN
        note = "" if seen else "the first scene's cameras do not see its place"
        return Change("new" if seen else "not seen", None, self.after.objects[row], None, note)


def _coverage(points: Traits, surfaces: Traits, near: float) -> Float[Tensor, "object other"]:
    """Share of the points of each object that lie on each object of the other capture."""
    found = torch.zeros(len(points.objects), len(surfaces.objects), dtype=torch.float64)
    counts = points.owners.bincount(minlength=len(points.objects) + 1)[:-1].clamp_min(1)
    for other in range(len(surfaces.objects)):
        on = on_surfaces(points, surfaces, near, other) < math.inf
        found[:, other] = points.owners[on].bincount(minlength=len(points.objects) + 1)[:-1]
    return found / counts[:, None]


def _covered_elsewhere(shares: Float[Tensor, "object other"], without: set[int]) -> dict[int, int]:
    """For each other object that lies on one of the other capture's, which that is."""
    best = shares.max(dim=1) if shares.shape[1] else None
    return {
        row: int(best.indices[row])
        for row in range(len(shares))
        if best is not None and row not in without and best.values[row] >= COVERED
    }


def _same_sides(first: Traits, second: Traits, row: int, other: int) -> bool:
    sides = first.extents[row].log() - second.extents[other].log()
    return float(sides.abs().max()) < SIDES


def _part(first: Traits, second: Traits, row: int, joined: dict[int, int]) -> Change:
    note = "a part of that object in the second scene"
    return Change("unchanged", first.objects[row], second.objects[joined[row]], None, note)


def _part_after(first: Traits, second: Traits, row: int, joined: dict[int, int]) -> Change:
    note = "a part of that object in the first scene"
    return Change("unchanged", first.objects[joined[row]], second.objects[row], None, note)


def _in_sight(
    scene: "Scene", depths: Float[Tensor, "view height width"], points: Float[Tensor, "point 3"]
) -> float:
    """Share of some points that a scene's cameras see; 1 of a scene without cameras."""
    if not scene.views or not len(points):
        return 1.0
    near, _ = scene.near_far
    seen: Bool[Tensor, " point"] = torch.zeros(len(points), dtype=torch.bool)
    for view in range(len(scene.views)):
        local = transform_points(scene.cameras.cam_from_world[view].double(), points)
        pixels = project(local, scene.cameras.intrinsics[view].double())
        x, y = pixels[:, 0].floor().long(), pixels[:, 1].floor().long()
        inside = (local[:, 2] > near) & (x >= 0) & (y >= 0)
        inside &= (x < scene.width) & (y < scene.height)
        shown = depths[view][y.clamp(0, scene.height - 1), x.clamp(0, scene.width - 1)].double()
        seen |= inside & ((shown == 0) | (local[:, 2] < HIDDEN_BY * shown))
    return float(seen.double().mean())
