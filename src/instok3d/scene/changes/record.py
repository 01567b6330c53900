"""What became of each object between two captures of one room, in words and in JSON."""

import math
from dataclasses import dataclass
from typing import Any, Literal

from instok3d.geometry.moving import Point
from instok3d.scene.changes.alignment import Alignment
from instok3d.scene.objects import SceneObject

FORMAT, VERSION = "instok3d-difference", 1
Kind = Literal["unchanged", "moved", "gone", "new", "not seen"]
KINDS: tuple[Kind, ...] = ("moved", "gone", "new", "unchanged", "not seen")


@dataclass(frozen=True)
class Change:
    """What became of one object."""

    kind: Kind
    before: SceneObject | None
    """In the first scene; None of what is new."""
    after: SceneObject | None
    """In the second scene; None of what is gone."""
    by: Point | None = None
    """How far its centroid is from where it was, in the second scene's world and units; None where
    the object is not known in both."""
    note: str = ""

    @property
    def distance(self) -> float | None:
        """Length of `by`."""
        return None if self.by is None else math.hypot(*self.by)


@dataclass(frozen=True)
class Difference:
    """The changes between two scenes of one room, with the alignment that they rest on."""

    changes: tuple[Change, ...]
    """By kind in the order of KINDS, then by id."""
    alignment: Alignment
    radius: float
    """Median distance of the second scene's points from their middle, its units."""
    tolerance: float
    """Distance up to which objects count as unchanged, large ones up to `by_surfaces.OWN` of
    their longest side; the second scene's units."""
    unit: str
    """Of lengths in words and values: "m", or "units"."""
    length: float
    """What lengths of the second scene are multiplied by to be in that unit."""

    def of_kind(self, kind: Kind) -> tuple[Change, ...]:
        """The changes of one kind."""
        return tuple(each for each in self.changes if each.kind == kind)

    def __str__(self) -> str:
        found = self.alignment
        on = f"{found.matches} places" if found.matches else f"{len(found.pairs)} objects"
        lines = [
            f"aligned on {on}: {found.agreement:.0%} of the surfaces agree, "
            f"to {self.length * found.residual:.3g} {self.unit} "
            f"({found.residual / max(self.radius, 1e-12):.1%} of the room's radius); moves below "
            f"{self.length * self.tolerance:.2g} {self.unit} are not told"
        ]
        for kind in KINDS:
            lines += [f"{kind:10} {self._words(each)}" for each in self.of_kind(kind)]
        counts = ", ".join(f"{len(self.of_kind(kind))} {kind}" for kind in KINDS)
        return "\n".join([*lines, counts])

    def to_json(self) -> dict[str, Any]:
        """In plain values; lengths in `units`."""
        found, move = self.alignment, self.alignment.second_from_first
        return {
            "format": FORMAT,
            "version": VERSION,
            "units": "metres" if self.unit == "m" else "units of the second scene",
            "metres_per_unit": self.length if self.unit == "m" else None,
            "alignment": {
                "scale": move.scale, "quat_wxyz": list(move.quat_wxyz),
                "translation": list(move.translation), "shared_objects": len(found.pairs),
                "shared_places": found.matches,
                "agreement": found.agreement, "residual": self.length * found.residual,
                "tolerance": self.length * self.tolerance,
            },
            "changes": [
                {"kind": each.kind,
                 "before": None if each.before is None else each.before.key,
                 "after": None if each.after is None else each.after.key,
                 "by": None if each.by is None else [self.length * value for value in each.by],
                 "distance": None if each.distance is None else self.length * each.distance,
                 "note": each.note}
                for each in self.changes
            ],
        }  # fmt: skip

    def _words(self, each: Change) -> str:
        keys = [item.key for item in (each.before, each.after) if item is not None]
        keys = list(dict.fromkeys(keys))
        words = " -> ".join(keys)
        if each.kind == "moved" and each.distance is not None:
            words += f" by {self.length * each.distance:.3g} {self.unit}"
        return f"{words} ({each.note})" if each.note else words
