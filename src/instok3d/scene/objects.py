"""What a scene says of each of its objects: where it is, how large, where it is seen best."""

import re
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch

from instok3d.geometry.rotations import quat_to_matrix
from instok3d.reading import number, one_of, text, whole_number, whole_numbers
from instok3d.scene.boxes import AlignedBox, OrientedBox, Point, finite_numbers
from instok3d.scene.names import UNLABELLED, read_label_source
from instok3d.scene.visibility import BestView, LateSight, Sight, read_sight

FRAGMENT_SHARE = 0.035
"""Of the pixels of a view: a fragment has no more in any view."""
UNSURE, UNSURE_OF_CUT = 0.6, 0.7
"""Confidence below which a small object is a fragment; the same where the frame cuts it off in
every view that shows it. Chosen on training rooms, docs/log.md, 2026-11-30."""


def likely_fragment(confidence: float, largest_share: float, *, cut_off: bool) -> bool:
    """Whether an object is likely a piece of a thing and no whole thing.

    Args:
        confidence: Of the object.
        largest_share: Of the pixels of a view, in the view that shows most of it.
        cut_off: It meets the frame in every view that shows it.
    """
    return largest_share <= FRAGMENT_SHARE and confidence < (UNSURE_OF_CUT if cut_off else UNSURE)


@dataclass(frozen=True, repr=False)
class SceneObject:
    """One object of a scene."""

    id: int
    """Its value in id maps: the group's index + 1, since 0 is no object there."""
    key: str
    """A name that can be typed: "object#3"."""
    color: str
    """Display colour as #rrggbb, the same for the same id in every scene."""
    aabb: AlignedBox
    obb: OrientedBox
    centroid: Point
    """Mean of the Gaussians' centres weighted by opacity."""
    num_anchors: int
    num_gaussians: int
    gaussian_range: tuple[int, int]
    """Start and count of its rows among the scene's Gaussians, and in an exported PLY."""
    confidence: float
    """Mean of the group's composited map over the input pixels that it won when the object was
    found, in [0, 1]; edits keep it. 1 for objects that a file named."""
    sight: Sight | LateSight = Sight()  # noqa: RUF009 - a Sight is frozen
    label: str | None = None
    label_source: str | None = None
    """Who named it: USER, "semantics:" and the encoder, or FILE; None without a label."""
    label_score: float | None = None
    """Probability of a label that semantics gave, in [0, 1]; None of others."""
    hidden: bool = False
    """Not drawn, not exported; its Gaussians stay in the scene."""

    @property
    def visible_in(self) -> tuple[int, ...]:
        """Input views in which it wins enough pixels."""
        return self.sight.visible_in

    @property
    def best_view(self) -> BestView | None:
        """The input view that shows most of it; None where none does."""
        return self.sight.best_view

    @property
    def is_fragment(self) -> bool:
        """Whether it is likely a piece of a thing and no whole thing (`likely_fragment`).

        False where no view shows it.
        """
        # A sure object is none, wherever it is seen: to find its masks after an edit takes renders.
        if self.confidence >= UNSURE_OF_CUT or not self.sight.masks:
            return False
        masks = self.sight.masks
        share = max(mask.area / (mask.height * mask.width) for mask in masks)
        cut_off = all(mask.meets_frame() for mask in masks)
        return likely_fragment(self.confidence, share, cut_off=cut_off)

    def __repr__(self) -> str:
        size = "x".join(f"{length:.2g}" for length in self.obb.size)
        label = f" label={self.label!r}" if self.label else ""
        hidden = " hidden" if self.hidden else ""
        return (
            f"<SceneObject {self.key}{label} gaussians={self.num_gaussians} size={size} "
            f"confidence={self.confidence:.2f}{hidden}>"
        )

    def height_along(self, up: Point) -> float:
        """Extent of the oriented box along a direction of unit length, scene units."""
        axes = quat_to_matrix(torch.tensor(self.obb.quat_wxyz, dtype=torch.float64))
        along = (torch.tensor(up, dtype=torch.float64) @ axes).abs()
        return float(along @ torch.tensor(self.obb.size, dtype=torch.float64))

    def to_json(self, up: Point, *, length: float = 1.0) -> dict[str, Any]:
        """An entry of objects.json, by its schema.

        Args:
            up: Of the scene.
            length: What lengths are multiplied by.
        """

        def scaled(values: Point) -> list[float]:
            return [length * value for value in values]

        best, seen = self.best_view, zip(self.visible_in, self.sight.masks, strict=True)
        return {
            "id": self.id,
            "key": self.key,
            "label": self.label,
            "label_source": self.label_source,
            "label_score": self.label_score,
            "confidence": self.confidence,
            "fragment": self.is_fragment,
            "hidden": self.hidden,
            "color": self.color,
            "centroid": scaled(self.centroid),
            "height": length * self.height_along(up),
            "aabb": {"min": scaled(self.aabb.min), "max": scaled(self.aabb.max)},
            "obb": {
                "center": scaled(self.obb.center),
                "size": scaled(self.obb.size),
                "quat_wxyz": list(self.obb.quat_wxyz),
            },
            "num_anchors": self.num_anchors,
            "num_gaussians": self.num_gaussians,
            "gaussian_range": list(self.gaussian_range),
            "embedding_row": None,
            "best_view": None if best is None else {
                "view": best.view, "pixels": best.pixels, "box": list(best.bbox),
            },
            "seen": [
                {"view": view, "pixels": mask.area, "box": list(mask.box()),
                 "mask": mask.to_json()}
                for view, mask in seen
            ],
        }  # fmt: skip

    @staticmethod
    def from_json(value: Any) -> "SceneObject":
        """The object of an entry of objects.json; unknown keys are ignored.

        Entries of scene folders of versions 1 to 3 have no masks.

        Raises:
            KeyError, TypeError, ValueError: An entry is missing or of the wrong kind.
        """
        color, label = text(value["color"]), value.get("label")
        if not re.fullmatch("#[0-9a-f]{6}", color):
            raise ValueError(f"{reprlib.repr(color)} is no colour such as #40bf9f")
        return SceneObject(
            id=whole_number(value["id"], 1),
            key=text(value["key"]),
            color=color,
            aabb=AlignedBox.from_json(value["aabb"]),
            obb=OrientedBox.from_json(value["obb"]),
            centroid=finite_numbers(value["centroid"], 3),
            num_anchors=whole_number(value["num_anchors"]),
            num_gaussians=whole_number(value["num_gaussians"]),
            gaussian_range=whole_numbers(value["gaussian_range"], 2),
            confidence=_share(value["confidence"]),
            sight=read_sight(value),
            label=None if label is None else text(label),
            label_source=read_label_source(value),
            label_score=None if value.get("label_score") is None else _share(value["label_score"]),
            hidden=one_of(value.get("hidden", False), (False, True)),
        )


def whole_first(objects: Sequence[SceneObject]) -> list[SceneObject]:
    """The objects in their order, fragments behind all others."""
    return sorted(objects, key=lambda item: item.is_fragment)


def counted(objects: Sequence[SceneObject]) -> str:
    """How many objects there are, and how many of them are fragments, in words."""
    fragments = sum(item.is_fragment for item in objects)
    aside = f" ({fragments} of them fragments)" if fragments else ""
    return f"{len(objects)} object{'' if len(objects) == 1 else 's'}{aside}"


def find_object(objects: Sequence[SceneObject], which: int | str) -> SceneObject:
    """The object of an id, a key such as "chair#3", or a label.

    "object#3" is the one of id 3, whatever it is labelled.

    Raises:
        KeyError: There is no such object, or several of that label.
    """
    for candidate in objects:
        if which in (candidate.id, candidate.key) and not isinstance(which, bool):
            return candidate
    labelled = [candidate for candidate in objects if candidate.label == which]
    if len(labelled) == 1:
        return labelled[0]
    if labelled:
        keys = ", ".join(candidate.key for candidate in labelled)
        raise KeyError(f"{len(labelled)} objects have the label {which!r}; name one of: {keys}")
    unlabelled = [each for each in objects if f"{UNLABELLED}#{each.id}" == which]
    if unlabelled:
        return unlabelled[0]
    known = ", ".join(str(candidate.id) for candidate in objects) or "none"
    raise KeyError(f"no object {which!r} in this scene; its ids are: {known}")


def _share(value: Any) -> float:
    if not 0 <= number(value) <= 1:
        raise ValueError(f"{reprlib.repr(value)} is no number in [0, 1]")
    return number(value)
