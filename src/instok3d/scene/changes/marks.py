"""Anchors as marks: places whose look the model knows, to be found in another capture."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from instok3d.geometry.moving import Similarity
from instok3d.scene.objects import SceneObject
from instok3d.scene.record import SceneRecord
from instok3d.sfm.matches import mutual_neighbours

MOST = 3000
"""Of a scene, evenly among its anchors: bounds the comparison of all with all."""
ALIKE = 0.5
"""Cosine from which on two marks may show one place."""


@dataclass(frozen=True)
class Marks:
    """Places of a capture, and how they look to the model that made it."""

    positions: Float[Tensor, "mark 3"]
    """Scene's world and units."""
    looks: Float[Tensor, "mark channel"]
    """Unit vectors: the anchors' tokens less their mean, which all of a scene share."""
    owners: Int[Tensor, " mark"]
    """Row of each one's object; the number of objects for those of none."""
    model: str
    """Looks of one model alone can be compared."""

    def comparable(self, other: "Marks") -> bool:
        """Whether both are there and of one model."""
        same = self.model == other.model and self.looks.shape[1] == other.looks.shape[1] > 0
        return same and min(len(self.looks), len(other.looks)) > 0

    def carried(self, move: Similarity) -> "Marks":
        """In another world."""
        return replace(self, positions=move.points(self.positions))


def marks_of(scene: SceneRecord, drawn: Sequence[SceneObject]) -> Marks:
    """The marks of a scene, hidden objects left out.

    Args:
        scene: Any; one that was imported from a file has marks without looks.
        drawn: Objects whose rows owners are.
    """
    tokens = scene.tokens.map(lambda value: value.detach().cpu())
    group = tokens.assignment.argmax(dim=1)
    row_of = torch.full((tokens.assignment.shape[1],), len(drawn))
    for row, item in enumerate(drawn):
        row_of[item.id - 1] = row
    hidden = [item.id - 1 for item in scene.objects if item.hidden]
    kept = (~torch.isin(group, torch.tensor(hidden, dtype=torch.long))).nonzero()[:, 0]
    kept = kept[:: max(1, -(-len(kept) // MOST))]
    anchors = tokens.anchors[kept].double()
    looks = anchors - anchors.mean(dim=0) if len(kept) else anchors
    made = scene.provenance
    return Marks(
        tokens.positions[kept].double(), functional.normalize(looks, dim=1), row_of[group[kept]],
        f"{made.model} {made.model_sha256}",
    )  # fmt: skip


def matched(first: Marks, second: Marks, least: float = ALIKE) -> Int[Tensor, "match 2"]:
    """Rows of marks that look most like each other."""
    return mutual_neighbours(first.looks, second.looks, least_similarity=least)
