"""A scene in a few words and in plain values, for people and for language models.

Everything follows from boxes, labels and the colours that the input views show: nothing is made up
where one of them is missing.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.scene.boxes import Point
from instok3d.scene.object_list import Scale, own_scale
from instok3d.scene.objects import SceneObject
from instok3d.scene.said_relations import SaidRelation, said_relations
from instok3d.scene.seen_colors import FLOOR, seen_color_shares
from instok3d.scene.upright_boxes import level_axes, upright_boxes
from instok3d.scene.vertical import STATED
from instok3d.semantics.query.ranking import COLOR_NAMES
from instok3d.semantics.query.relations import UprightBoxes

if TYPE_CHECKING:
    from instok3d.scene.scene import Scene

FORMAT, VERSION = "instok3d-description", 1
MOST = 60
"""Objects that are described unless another number is asked for."""
WALL = "wall"
"""Label of what things stand against."""
PLAIN, MIXED = 0.5, 0.3
"""Share of an object's pixels from which on one colour is its colour; from which on each of two."""


@dataclass(frozen=True)
class DescribedObject:
    """An object as a description has it. Lengths are in the description's unit."""

    object: SceneObject
    size: Point
    """Length (the longer level side), width and height of its upright box."""
    middle: Point
    """Of that box in the room's axes: x and y level, along the walls, z above the lowest thing."""
    base: float
    """Height of its lowest point above the lowest of all."""
    colors: tuple[str, ...]
    """One name, or two where neither prevails; none where no input view shows it."""


@dataclass(frozen=True)
class Description:
    """What is in a scene; `str()` of it is a short text."""

    objects: tuple[DescribedObject, ...]
    """The largest ones, by rising id."""
    relations: tuple[SaidRelation, ...]
    """Between these, by their numbers in `objects`."""
    scale: Scale
    room_from_world: Float[Tensor, "4 4"]
    """Takes points of the scene's world, scene units, to the room's axes, still scene units."""
    size: Point
    """Length, width and height of the box of all objects that are drawn."""
    up_confidence: float
    """Probability that up is known to 15 degrees (`Vertical.confidence`)."""
    num_views: int
    num_hidden: int
    """Objects that are left out because they are hidden."""
    num_smaller: int
    """Objects that are left out because they are smaller than those that were asked for."""
    num_fragments: int
    """Objects that are left out because they are likely pieces of things."""
    rest: float
    """Share of the Gaussians that belong to no object."""

    @property
    def unit(self) -> str:
        """Of lengths: "m", or "units" of unknown length."""
        return "units" if self.scale.metres_per_unit is None else "m"

    def __str__(self) -> str:
        return "\n".join([*self._head(), *(self._line(row) for row in range(len(self.objects)))])

    def to_json(self) -> dict[str, Any]:
        """In plain values."""
        keys = [each.object.key for each in self.objects]
        metres = self.scale.metres_per_unit
        return {
            "format": FORMAT,
            "version": VERSION,
            "text": str(self),
            "units": "arbitrary" if metres is None else "metres",
            "metres_per_scene_unit": metres,
            "up_confidence": self.up_confidence,
            "room_from_world": self.room_from_world.tolist(),
            "size": _named(self.size),
            "views": self.num_views,
            "objects": [_as_values(each) for each in self.objects],
            "relations": [
                {"subject": keys[each.subject], "relation": each.kind, "object": keys[each.other],
                 "fit": round(each.fit, 3)}
                for each in self.relations
            ],
            "left_out": {"hidden": self.num_hidden, "smaller": self.num_smaller,
                         "fragments": self.num_fragments,
                         "share_of_gaussians": round(self.rest, 4)},
        }  # fmt: skip

    def _head(self) -> list[str]:
        seen = f", seen in {_count(self.num_views, 'photo')}" if self.num_views else ""
        count = len(self.objects) + self.num_smaller
        lines = [f"A scene of {_count(count, 'object')}{seen}."]
        if self.objects:
            across = " x ".join(_length(value) for value in self.size)
            lines[0] = f"{lines[0][:-1]}, {across} {self.unit} (length x width x height)."
        if self.scale.metres_per_unit is None:
            lines.append("The unit of lengths is unknown; their ratios are right.")
        if self.up_confidence < STATED:
            lines.append(
                "Which way is up is uncertain (within 15 degrees with probability "
                f"{self.up_confidence:.2f}), so heights and places are rough."
            )
        left = [
            f"{_count(self.num_hidden, 'hidden object')}" * bool(self.num_hidden),
            f"{_count(self.num_smaller, 'smaller object')}" * bool(self.num_smaller),
            f"{_count(self.num_fragments, 'fragment')}" * bool(self.num_fragments),
            f"{self.rest:.0%} of the scene, which belongs to no object" * (self.rest >= 0.005),
        ]
        left = [words for words in left if words]
        return [*lines, *([f"Left out: {', '.join(left)}."] if left else [])]

    def _line(self, row: int) -> str:
        each = self.objects[row]
        size = " x ".join(_length(value) for value in each.size)
        place = ", ".join(_length(value) for value in each.middle[:2])
        parts = [" and ".join(each.colors)] if each.colors else []
        parts += [f"{size} {self.unit}", f"at ({place})", f"base at height {_length(each.base)}"]
        kinds: dict[str, list[str]] = {}
        for said in self.relations:
            if said.subject == row:
                kinds.setdefault(said.kind, []).append(self.objects[said.other].object.key)
        parts += [f"{kind} {' and '.join(keys)}" for kind, keys in kinds.items()]
        return f"- {each.object.key}: {'; '.join(parts)}"


def describe(scene: "Scene", scale: Scale | None = None, *, most: int = MOST) -> Description:
    """The description of a scene; the same for the same scene. Renders its input views.

    Hidden objects and fragments (`SceneObject.is_fragment`) are left out, and counted.

    Args:
        scene: With or without views, labels, semantics.
        scale: None takes what the scene knows itself.
        most: Only so many objects, the largest ones.

    Raises:
        ValueError: `most` is below 1.
    """
    if most < 1:
        raise ValueError(f"most must be at least 1 object, got {most}")
    scale = scale or own_scale(scene)
    visible = [item for item in scene.objects if not item.hidden]
    drawn = [item for item in visible if not item.is_fragment]
    every = upright_boxes(scene, drawn)
    volumes = every.size.double().prod(dim=1).tolist()
    rows = sorted(sorted(range(len(drawn)), key=lambda row: (-volumes[row], row))[:most])
    objects = [drawn[row] for row in rows]
    boxes = UprightBoxes(every.low[rows], every.high[rows])
    walls = [_class_of(item) == WALL for item in drawn]
    said = said_relations(every, torch.tensor(walls, dtype=torch.bool))
    low, high = _ends(every)
    length = scale.metres_per_unit or 1.0
    owned = sum(item.num_gaussians for item in scene.objects)
    return Description(
        objects=_described(objects, boxes, low, length, _colors(scene, objects)),
        relations=_between(said, rows),
        scale=scale,
        room_from_world=_room_from_world(level_axes(drawn, scene.vertical.up), low),
        size=_size(length * (high - low)),
        up_confidence=scene.vertical.confidence,
        num_views=len(scene.views),
        num_hidden=len(scene.objects) - len(visible),
        num_smaller=len(drawn) - len(objects),
        num_fragments=len(visible) - len(drawn),
        rest=1 - owned / len(scene.gaussians.means) if len(scene.gaussians.means) else 0.0,
    )


def _between(said: tuple[SaidRelation, ...], rows: list[int]) -> tuple[SaidRelation, ...]:
    """The relations between some things, by their numbers among these."""
    place = {row: number for number, row in enumerate(rows)}
    return tuple(
        replace(each, subject=place[each.subject], other=place[each.other])
        for each in said
        if each.subject in place and each.other in place
    )


def _described(
    objects: list[SceneObject],
    boxes: UprightBoxes,
    origin: Float[Tensor, " 3"],
    length: float,
    colors: list[tuple[str, ...]],
) -> tuple[DescribedObject, ...]:
    found = []
    for item, low, high, names in zip(objects, boxes.low, boxes.high, colors, strict=True):
        middle = _point(length * ((low + high) / 2 - origin))
        base = float(length * (low[2] - origin[2]))
        found.append(DescribedObject(item, _size(length * (high - low)), middle, base, names))
    return tuple(found)


def _colors(scene: "Scene", objects: list[SceneObject]) -> list[tuple[str, ...]]:
    """The colours of each object that are worth naming."""
    shares = seen_color_shares(scene, objects)
    if shares is None:
        return [()] * len(objects)
    named = []
    for row in (shares - FLOOR).tolist():
        order = sorted(range(len(row)), key=lambda place: -row[place])
        shown = [place for place in order[:2] if row[place] >= MIXED]
        shown = shown[:1] if shown and row[shown[0]] >= PLAIN else shown
        named.append(tuple(COLOR_NAMES[place] for place in shown))
    return named


def _class_of(item: SceneObject) -> str | None:
    return None if item.label is None else item.label.lower()


def _ends(boxes: UprightBoxes) -> tuple[Float[Tensor, " 3"], Float[Tensor, " 3"]]:
    """Lowest and highest corner of all boxes; zeros where there is none."""
    if not len(boxes.low):
        return torch.zeros(3), torch.zeros(3)
    return boxes.low.amin(dim=0), boxes.high.amax(dim=0)


def _room_from_world(
    axes: Float[Tensor, "3 3"], origin: Float[Tensor, " 3"]
) -> Float[Tensor, "4 4"]:
    found = torch.eye(4, dtype=torch.float64)
    found[:3, :3] = axes.T
    found[:3, 3] = -origin.double()
    return found


def _as_values(each: DescribedObject) -> dict[str, Any]:
    item = each.object
    return {
        "id": item.id,
        "key": item.key,
        "label": item.label,
        "label_source": item.label_source,
        "label_score": item.label_score,
        "confidence": item.confidence,
        "size": _named(each.size),
        "middle": list(each.middle),
        "base": each.base,
        "colors": list(each.colors),
    }


def _named(size: Point) -> dict[str, float]:
    return dict(zip(("length", "width", "height"), size, strict=True))


def _point(values: Tensor) -> Point:
    x, y, z = values.tolist()
    return x, y, z


def _size(values: Float[Tensor, " 3"]) -> Point:
    """Length, width, height of a box's sides in the room's axes."""
    first, second, height = values.tolist()
    return max(first, second), min(first, second), height


def _length(value: float) -> str:
    """Two decimals, which is a centimetre of metres; more of what is smaller than that."""
    shown = f"{value:.2f}" if abs(value) >= 0.0995 or abs(value) < 5e-4 else f"{value:.3f}"
    return "0.00" if float(shown) == 0 else shown


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
