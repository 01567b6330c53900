"""What changed between two captures of one room: unchanged, moved, gone, new, or not seen."""

from typing import TYPE_CHECKING

import torch

from instok3d.scene.changes.alignment import align
from instok3d.scene.changes.by_sight import SightComparison
from instok3d.scene.changes.by_surfaces import SurfaceComparison
from instok3d.scene.changes.marked_alignment import align_marks
from instok3d.scene.changes.record import KINDS, Change, Difference
from instok3d.scene.changes.traits import traits_of

if TYPE_CHECKING:
    from instok3d.scene.scene import Scene


def find_differences(first: "Scene", second: "Scene", *, seed: int = 0) -> Difference:
    """What changed from a first to a second capture of one room.

    Two scenes that one model made of photos are compared by what the cameras of each see of the
    other's things (`by_sight`); others, such as imported ones, by their surfaces (`by_surfaces`).

    Args:
        first: The room before.
        second: The room after; the answer is in its world and units.
        seed: Of the search for the alignment.

    Raises:
        ValueError: The scenes cannot be aligned with trust (`align`, `align_marks`).
    """
    before, after = traits_of(first), traits_of(second)
    if first.views and second.views and before.marks.comparable(after.marks):
        found = align_marks(before, after, seed=seed)
        changes, tolerance = SightComparison(first, second, before, after, found).changes()
    else:
        ups = (torch.tensor(first.vertical.up), torch.tensor(second.vertical.up))
        found = align(before, after, ups, seed=seed)
        changes, tolerance = SurfaceComparison(first, second, before, after, found).changes()
    order = sorted(changes, key=lambda each: (KINDS.index(each.kind), _ids(each)))
    scale = found.second_from_first.scale
    metres = {"second": 1.0, "first": 1 / scale}
    known = [metres[name] for name, scene in (("second", second), ("first", first))
             if scene.units == "metres"]  # fmt: skip
    unit, length = ("m", known[0]) if known else ("units", 1.0)
    return Difference(tuple(order), found, after.radius, tolerance, unit, length)


def _ids(each: Change) -> tuple[int, int]:
    ids = [0 if item is None else item.id for item in (each.before, each.after)]
    return ids[0] or ids[1], ids[1]
