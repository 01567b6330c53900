"""Where the input views show an object, as a scene keeps it; `sight` finds it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from instok3d.reading import whole_number, whole_numbers
from instok3d.scene.run_lengths import RunLengths


@dataclass(frozen=True)
class BestView:
    """The input view that shows most of an object."""

    view: int
    """Index of the input view."""
    bbox: tuple[int, int, int, int]
    """x0, y0, x1, y1 in pixels of the view at the scene's size; x1 and y1 are exclusive."""
    pixels: int


@dataclass(frozen=True)
class Sight:
    """Where the input views show an object, as if no object was hidden."""

    visible_in: tuple[int, ...] = ()
    """Input views in which it wins enough pixels."""
    best_view: BestView | None = None
    """None where no input view shows it."""
    masks: tuple[RunLengths, ...] = ()
    """Its pixels in each of the views of `visible_in`."""


class LateSight:
    """A `Sight` that is found when it is first asked for.

    After an edit: looking renders the id maps of all input views, which takes longer than any edit.
    """

    def __init__(self, find: Callable[[], Sight]) -> None:
        self._find = find

    @cached_property
    def _sight(self) -> Sight:
        return self._find()

    @property
    def visible_in(self) -> tuple[int, ...]:
        """As of a `Sight`."""
        return self._sight.visible_in

    @property
    def best_view(self) -> BestView | None:
        """As of a `Sight`."""
        return self._sight.best_view

    @property
    def masks(self) -> tuple[RunLengths, ...]:
        """As of a `Sight`."""
        return self._sight.masks

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Sight | LateSight):
            return NotImplemented
        return self._sight == Sight(other.visible_in, other.best_view, other.masks)

    def __hash__(self) -> int:
        return hash(self._sight)


def read_sight(value: Any) -> Sight:
    """Where an entry says that an object is seen, old and new."""
    best, found = value["best_view"], None
    old = "visible_in" in value
    if best is not None:
        box = whole_numbers(best["bbox" if old else "box"], 4)
        found = BestView(whole_number(best["view"]), box, whole_number(best["pixels"]))
    if old:
        views = value["visible_in"]
        return Sight(whole_numbers(views, len(views)), found)
    seen = [(whole_number(each["view"]), RunLengths.from_json(each["mask"]))
            for each in value["seen"]]  # fmt: skip
    for each, (_, mask) in zip(value["seen"], seen, strict=True):
        if each["pixels"] != mask.area:
            raise ValueError(f"a mask of {mask.area} pixels is said to have {each['pixels']}")
    return Sight(tuple(view for view, _ in seen), found, tuple(mask for _, mask in seen))
