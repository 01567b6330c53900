# ruff: noqa: D102 - apply and words are documented by Edit
"""The operations that an edit log can hold: what each does to a scene, exactly and at once.

All that had to be decided (where an object stands, which Gaussians go with it) is in the operation,
so that doing it again on the same scene gives the same bytes. `EditableScene` makes them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from instok3d.geometry.moving import Similarity
from instok3d.scene.edits.ownership import (
    Part,
    given_to,
    part_of,
    rebuilt,
    row_ids,
    with_more,
    with_part,
    without_rows,
)
from instok3d.scene.edits.recoloring import recolored
from instok3d.scene.edits.scene_objects import another_of, carried, new_object, object_of
from instok3d.scene.edits.wording import hole_words, keys, moved_words
from instok3d.scene.names import FILE, USER, check_label, key_of
from instok3d.scene.objects import SceneObject
from instok3d.scene.record import SceneRecord
from instok3d.scene.run_lengths import RunLengths
from instok3d.scene.semantics import merged as merged_semantics
from instok3d.scene.vertical import given_up
from instok3d.types import Gaussians


@runtime_checkable
class Edit(Protocol):
    """One operation. Its fields say by a word how the log keeps them (`log.KINDS`)."""

    name: ClassVar[str]

    def apply(self, scene: SceneRecord) -> SceneRecord:
        """The scene after it.

        Raises:
            KeyError: An object is not there.
            ValueError: It cannot be done on this scene.
        """
        ...

    def words(self, scene: SceneRecord) -> str:
        """What it does, in words, with the names that the objects have before it."""
        ...


@dataclass(frozen=True)
class Remove:
    """Objects go, and Gaussians of others that were claimed with them."""

    name: ClassVar[str] = "remove"
    objects: Annotated[tuple[int, ...], "ids"]
    claimed: Annotated[Int[Tensor, " row"], "rows"]
    """Rows among the scene's Gaussians that go too: haloes at the rim (`edits.claim`)."""
    hole: Annotated[tuple[RunLengths, ...] | None, "masks"] = None
    """The hole that it leaves in each input view (`edits.holes`); None where nobody looked."""
    invented: Annotated[Gaussians | None, "gaussians"] = None
    """Gaussians that fill the hole (`edits.fill`); anchor_index names anchors of what is left."""

    def dropped_rows(self, scene: SceneRecord) -> Bool[Tensor, " gaussian"]:
        """Which Gaussians of the scene before go."""
        dropped = _rows_of(scene, self.objects)
        dropped[_checked_rows(self.claimed, len(dropped))] = True
        return dropped

    def apply(self, scene: SceneRecord) -> SceneRecord:
        left = without_rows(scene, self.dropped_rows(scene), self.objects)
        return left if self.invented is None else with_more(left, self.invented)

    def words(self, scene: SceneRecord) -> str:
        rim = f" and {len(self.claimed)} Gaussians at the rim" if len(self.claimed) else ""
        count = num_invented(self)
        fill = f"; {count} invented Gaussians extend the surfaces around it" if count else ""
        return f"remove {keys(scene, self.objects)}{rim}{hole_words(self.hole)}{fill}"


@dataclass(frozen=True)
class Only:
    """Everything goes but some objects."""

    name: ClassVar[str] = "only"
    objects: Annotated[tuple[int, ...], "ids"]

    def apply(self, scene: SceneRecord) -> SceneRecord:
        dropped = ~_rows_of(scene, self.objects)
        gone = {0} | {item.id for item in scene.objects} - set(self.objects)
        return without_rows(scene, dropped, gone)

    def words(self, scene: SceneRecord) -> str:
        return f"keep {keys(scene, self.objects)} alone"


@dataclass(frozen=True)
class Move:
    """An object is moved, turned, scaled."""

    name: ClassVar[str] = "move"
    object: Annotated[int, "id"]
    motion: Annotated[Similarity, "motion"]

    def apply(self, scene: SceneRecord) -> SceneRecord:
        item = object_of(scene, self.object)
        part = part_of(scene, item)
        moved = carried(part, self.motion)
        positions = scene.tokens.positions.clone()
        own = scene.gaussians.rows(_range(item)).anchor_index.unique()
        positions[own] = moved.positions
        tokens = replace(scene.tokens, positions=positions)
        changed = _with_range(scene.gaussians, item, moved.gaussians)
        counts = {each.id: each.num_gaussians for each in scene.objects}
        return rebuilt(scene, changed, tokens, scene.objects, counts, {item.id})

    def words(self, scene: SceneRecord) -> str:
        return f"move {moved_words(scene, self.object, self.motion)}"


@dataclass(frozen=True)
class Duplicate:
    """A second one of an object, moved away from the first."""

    name: ClassVar[str] = "duplicate"
    object: Annotated[int, "id"]
    motion: Annotated[Similarity, "motion"]

    def apply(self, scene: SceneRecord) -> SceneRecord:
        item = object_of(scene, self.object)
        part = carried(part_of(scene, item), self.motion)
        return with_part(scene, part, another_of(scene, item))

    def words(self, scene: SceneRecord) -> str:
        return f"duplicate {moved_words(scene, self.object, self.motion)}"


@dataclass(frozen=True)
class Insert:
    """An object of another scene, already in this one's world."""

    name: ClassVar[str] = "insert"
    part: Annotated[Part, "part"]
    label: Annotated[str | None, "label"]
    confidence: Annotated[float, "share"]
    origin: Annotated[str, "text"]
    """Where it comes from, in words."""
    label_source: Annotated[str | None, "source"] = None
    """As of a `SceneObject`; logs before version 3 did not say."""
    label_score: Annotated[float | None, "share or null"] = None

    def apply(self, scene: SceneRecord) -> SceneRecord:
        if self.part.anchors.shape[1] != scene.tokens.anchors.shape[1]:
            raise ValueError(
                f"the part has tokens of {self.part.anchors.shape[1]} channels, the scene of "
                f"{scene.tokens.anchors.shape[1]}"
            )
        return with_part(scene, self.part, self._inserted(scene))

    def words(self, scene: SceneRecord) -> str:
        return f"insert {self.origin} as {self._inserted(scene).key}"

    def _inserted(self, scene: SceneRecord) -> SceneObject:
        source = None if self.label is None else self.label_source or FILE
        new = new_object(scene, self.label, self.confidence)
        return replace(new, label_source=source, label_score=self.label_score)


@dataclass(frozen=True)
class Recolor:
    """An object gets another colour; light and dark on it stay."""

    name: ClassVar[str] = "recolor"
    object: Annotated[int, "id"]
    color: Annotated[tuple[float, float, float], "color"]
    """SRGB in [0, 1]."""

    def apply(self, scene: SceneRecord) -> SceneRecord:
        item = object_of(scene, self.object)
        own = scene.gaussians.rows(_range(item))
        changed = _with_range(scene.gaussians, item, recolored(own, self.color))
        return rebuilt(
            scene, changed, scene.tokens, scene.objects,
            {each.id: each.num_gaussians for each in scene.objects}, (),
        )  # fmt: skip

    def words(self, scene: SceneRecord) -> str:
        color = "".join(f"{round(255 * value):02x}" for value in self.color)
        return f"recolor {keys(scene, [self.object])}: #{color}"


@dataclass(frozen=True)
class Merge:
    """Objects become one: the first of them."""

    name: ClassVar[str] = "merge"
    objects: Annotated[tuple[int, ...], "ids"]

    def apply(self, scene: SceneRecord) -> SceneRecord:
        target, *others = (object_of(scene, number) for number in self.objects)
        if not others or len(set(self.objects)) < len(self.objects):
            raise ValueError(f"merge needs two or more different objects, got {self.objects}")
        chosen = _rows_of(scene, [each.id for each in others])
        weights = [each.num_gaussians for each in (target, *others)]
        sums = [n * each.confidence for n, each in zip(weights, (target, *others), strict=True)]
        shares = {each.id - 1: float(each.num_gaussians) for each in (target, *others)}
        scene = replace(
            scene, semantics=merged_semantics(scene.semantics, shares, scene.tokens.assignment)
        )
        merged = given_to(scene, chosen, replace(target, confidence=sum(sums) / sum(weights)))
        pi = merged.tokens.assignment.clone()
        rows = pi.argmax(dim=1) == target.id - 1
        for each in others:
            pi[rows, target.id - 1] += pi[rows, each.id - 1]
            pi[rows, each.id - 1] = 0
        counts = {each.id: each.num_gaussians for each in merged.objects}
        tokens = replace(merged.tokens, assignment=pi)
        return rebuilt(merged, merged.gaussians, tokens, merged.objects, counts, ())

    def words(self, scene: SceneRecord) -> str:
        return f"merge {keys(scene, self.objects)}"


@dataclass(frozen=True)
class Split:
    """Some Gaussians of an object become a new one."""

    name: ClassVar[str] = "split"
    object: Annotated[int, "id"]
    rows: Annotated[Int[Tensor, " row"], "rows"]
    """Counted within the object."""

    def apply(self, scene: SceneRecord) -> SceneRecord:
        item = object_of(scene, self.object)
        rows = _checked_rows(self.rows, item.num_gaussians)
        if not 0 < len(rows.unique()) < item.num_gaussians:
            raise ValueError(f"{len(rows)} of {item.num_gaussians} Gaussians are no part of it")
        chosen = torch.zeros(len(scene.gaussians.means), dtype=torch.bool)
        chosen[item.gaussian_range[0] + rows] = True
        new = another_of(scene, item)
        return given_to(scene, chosen, replace(new, hidden=item.hidden))

    def words(self, scene: SceneRecord) -> str:
        new = another_of(scene, object_of(scene, self.object)).key
        return f"split {keys(scene, [self.object])}: {len(self.rows)} Gaussians are {new}"


@dataclass(frozen=True)
class Rename:
    """An object gets a label, and a key made of it."""

    name: ClassVar[str] = "rename"
    object: Annotated[int, "id"]
    label: Annotated[str, "text"]

    def apply(self, scene: SceneRecord) -> SceneRecord:
        item, label = object_of(scene, self.object), check_label(self.label)
        key = key_of(item.id, label)
        if any(each.key == key and each.id != item.id for each in scene.objects):
            raise ValueError(f"another object has the key {key!r} already: use another label")
        return _exchanged(scene, replace(item, label=label, key=key, label_source=USER,
                                         label_score=None))  # fmt: skip

    def words(self, scene: SceneRecord) -> str:
        return f"rename {keys(scene, [self.object])}: {self.label}"


@dataclass(frozen=True)
class Hide:
    """Objects are no longer drawn."""

    name: ClassVar[str] = "hide"
    objects: Annotated[tuple[int, ...], "ids"]

    def apply(self, scene: SceneRecord) -> SceneRecord:
        for number in self.objects:
            scene = _exchanged(scene, replace(object_of(scene, number), hidden=True))
        return scene

    def words(self, scene: SceneRecord) -> str:
        return f"hide {keys(scene, self.objects)}"


@dataclass(frozen=True)
class Show:
    """Objects are drawn again."""

    name: ClassVar[str] = "show"
    objects: Annotated[tuple[int, ...], "ids"]

    def apply(self, scene: SceneRecord) -> SceneRecord:
        for number in self.objects:
            scene = _exchanged(scene, replace(object_of(scene, number), hidden=False))
        return scene

    def words(self, scene: SceneRecord) -> str:
        return f"show {keys(scene, self.objects)}"


@dataclass(frozen=True)
class Up:
    """Another direction is up."""

    name: ClassVar[str] = "up"
    direction: Annotated[tuple[float, float, float], "direction"]
    """Unit length."""

    def apply(self, scene: SceneRecord) -> SceneRecord:
        return replace(scene, vertical=given_up(self.direction))

    def words(self, scene: SceneRecord) -> str:
        return f"up is ({', '.join(f'{value:.4g}' for value in self.direction)})"


OPERATIONS: dict[str, type[Edit]] = {
    kind.name: kind
    for kind in (
        Remove, Only, Move, Duplicate, Insert, Recolor, Merge, Split, Rename, Hide, Show, Up
    )
}  # fmt: skip
"""By the name that stands in a log."""


def num_invented(edit: Edit) -> int:
    """Gaussians that an edit adds and that no photo shows: those of fills."""
    invented = edit.invented if isinstance(edit, Remove) else None
    return 0 if invented is None else len(invented.means)


def _rows_of(scene: SceneRecord, ids: Sequence[int]) -> Tensor:
    for number in ids:
        object_of(scene, number)
    return torch.isin(row_ids(scene), torch.tensor([*ids], dtype=torch.long))


def _range(item: SceneObject) -> slice:
    start, count = item.gaussian_range
    return slice(start, start + count)


def _with_range(gaussians: Gaussians, item: SceneObject, own: Gaussians) -> Gaussians:
    """The Gaussians with those of one object exchanged, apart from their anchors."""
    fields = {}
    for name, value in vars(gaussians).items():
        if name != "anchor_index":
            value = value.clone()
            value[_range(item)] = vars(own)[name]
        fields[name] = value
    return Gaussians(**fields)


def _exchanged(scene: SceneRecord, item: SceneObject) -> SceneRecord:
    objects = tuple(item if each.id == item.id else each for each in scene.objects)
    return replace(scene, objects=objects)


def _checked_rows(rows: Tensor, count: int) -> Tensor:
    if len(rows) and not 0 <= int(rows.min()) <= int(rows.max()) < count:
        raise ValueError(f"rows up to {int(rows.max())} of {count} Gaussians cannot be")
    return rows
