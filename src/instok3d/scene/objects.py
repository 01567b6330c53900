"""What a scene says of each of its objects: where it is, how large, where it is seen best."""

import math
import re
import reprlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.rotations import matrix_to_quat, quat_to_matrix
from instok3d.reading import number, one_of, text, whole_number
from instok3d.scene.run_lengths import RunLengths
from instok3d.types import MAX_LENGTH, Gaussians

Point = tuple[float, float, float]
LARGEST = 100 * MAX_LENGTH
"""What a coordinate or a length can be: of boxes about the largest Gaussians."""
MAX_LABEL = 100
"""Characters of a label."""
UNLABELLED = "object"
"""Stands in the key of an object without a label."""
USER, FILE, SEMANTICS = "user", "given", "semantics:"
"""Sources of labels: a person's rename; an imported file, or an older program that did not say; the
beginning of those that an encoder gave."""
TAIL = 0.02
"""Share of an object's opacity that a box leaves out on each side of each axis: haze and strays."""


@dataclass(frozen=True)
class AlignedBox:
    """A box along the axes of the world."""

    min: Point
    max: Point

    @staticmethod
    def from_json(value: Any) -> "AlignedBox":
        """See `SceneObject.from_json`."""
        box = AlignedBox(_floats(value["min"], 3), _floats(value["max"], 3))
        if any(low > high for low, high in zip(box.min, box.max, strict=True)):
            raise ValueError(f"the box from {box.min} to {box.max} is inside out")
        return box


@dataclass(frozen=True)
class OrientedBox:
    """A box along the object's own principal axes."""

    center: Point
    size: Point
    """Full lengths along the box's axes, longest spread first."""
    quat_wxyz: tuple[float, float, float, float]
    """Rotation world_from_box."""

    @staticmethod
    def from_json(value: Any) -> "OrientedBox":
        """See `SceneObject.from_json`."""
        center, size = _floats(value["center"], 3), _floats(value["size"], 3)
        quat = _floats(value["quat_wxyz"], 4)
        if min(size) < 0:
            raise ValueError(f"the box has the size {size}")
        if abs(math.hypot(*quat) - 1) > 1e-3:
            raise ValueError(f"the quaternion {quat} is not of unit length")
        return OrientedBox(center, size, quat)


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
    sight: Sight | LateSight = Sight()
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
            centroid=_floats(value["centroid"], 3),
            num_anchors=whole_number(value["num_anchors"]),
            num_gaussians=whole_number(value["num_gaussians"]),
            gaussian_range=_whole_numbers(value["gaussian_range"], 2),
            confidence=_share(value["confidence"]),
            sight=_sight(value),
            label=None if label is None else text(label),
            label_source=_label_source(value),
            label_score=None if value.get("label_score") is None else _share(value["label_score"]),
            hidden=one_of(value.get("hidden", False), (False, True)),
        )


def check_label(label: str) -> str:
    """A label, without the spaces around it.

    Raises:
        ValueError: It is empty, longer than MAX_LABEL, has characters that cannot be printed on one
            line, or could be taken for an id or a key.
    """
    words = label.strip()
    if not 0 < len(words) <= MAX_LABEL or not words.isprintable():
        raise ValueError(
            f"the label {reprlib.repr(label)} must be 1 to {MAX_LABEL} printable characters"
        )
    if "#" in words or words.isdecimal():
        raise ValueError(
            f"the label {reprlib.repr(label)} could be taken for an id or a key: leave out '#' and "
            "use a word"
        )
    return words


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


def key_of(number: int, label: str | None) -> str:
    """The key of an object: its label, or "object" without one, and its id."""
    return f"{label or UNLABELLED}#{number}"


def check_label_source(source: str) -> str:
    """Who named an object.

    Raises:
        ValueError: It is neither USER nor FILE, nor begins with SEMANTICS.
    """
    known = source in (USER, FILE) or source.startswith(SEMANTICS)
    if not known or source == SEMANTICS or len(source) > MAX_LABEL:
        raise ValueError(f"{reprlib.repr(source)} is no source of a label")
    return source


def _label_source(value: Any) -> str | None:
    """Who named the object of an entry; versions before 3 say "given" alone."""
    source, label = value.get("label_source"), value.get("label")
    if label is None:
        if source is not None:
            raise ValueError(f"there is no label, but its source {reprlib.repr(source)}")
        return None
    if source is None:  # scene folders of versions 1 to 3
        return FILE
    return check_label_source(text(source))


def _sight(value: Any) -> Sight:
    """Where an entry says that an object is seen, old and new."""
    best, found = value["best_view"], None
    old = "visible_in" in value
    if best is not None:
        box = _whole_numbers(best["bbox" if old else "box"], 4)
        found = BestView(whole_number(best["view"]), box, whole_number(best["pixels"]))
    if old:
        views = value["visible_in"]
        return Sight(_whole_numbers(views, len(views)), found)
    seen = [(whole_number(each["view"]), RunLengths.from_json(each["mask"]))
            for each in value["seen"]]  # fmt: skip
    for each, (_, mask) in zip(value["seen"], seen, strict=True):
        if each["pixels"] != mask.area:
            raise ValueError(f"a mask of {mask.area} pixels is said to have {each['pixels']}")
    return Sight(tuple(view for view, _ in seen), found, tuple(mask for _, mask in seen))


def describe_shape(gaussians: Gaussians) -> tuple[AlignedBox, OrientedBox, Point]:
    """Boxes and centroid of unbatched Gaussians, at least one.

    Each Gaussian counts with its opacity, at its centre and at one standard deviation along its
    axes, so that a single flat splat has an extent too. The boxes span the quantiles from TAIL
    to 1 - TAIL along each axis: a box over all centres would be that of the faintest stray.
    """
    points, weights = _support(gaussians)
    center = (weights[:, None] * points).sum(0) / weights.sum()
    low, high = _extent(points, weights)
    axes = _principal_axes(points - center, weights)
    own_low, own_high = _extent(points @ axes, weights)
    box = OrientedBox(
        center=_floats((axes @ ((own_low + own_high) / 2)).tolist(), 3),
        size=_floats((own_high - own_low).tolist(), 3),
        quat_wxyz=_floats(matrix_to_quat(axes).tolist(), 4),
    )
    aligned = AlignedBox(_floats(low.tolist(), 3), _floats(high.tolist(), 3))
    return aligned, box, _floats(center.tolist(), 3)


def extent_along(gaussians: Gaussians, direction: Point) -> tuple[float, float]:
    """Where unbatched Gaussians, at least one, begin and end along a direction of unit length.

    As far as their boxes reach: the quantiles from TAIL to 1 - TAIL.
    """
    low, high = extents_along(gaussians, torch.tensor(direction, dtype=torch.float64)[:, None])
    return float(low), float(high)


def extents_along(
    gaussians: Gaussians, axes: Float[Tensor, "3 axis"]
) -> tuple[Float[Tensor, " axis"], Float[Tensor, " axis"]]:
    """As `extent_along`, of several directions of unit length (columns), float64."""
    points, weights = _support(gaussians)
    return _extent(points @ axes, weights)


def _support(
    gaussians: Gaussians,
) -> tuple[Float[Tensor, "point 3"], Float[Tensor, " point"]]:
    """Centres and the ends of the axes at one standard deviation, with their weights."""
    means = gaussians.means.detach().cpu().double()
    scales = gaussians.scales.detach().cpu().double()
    axes = quat_to_matrix(gaussians.quats.detach().cpu().double()) * scales[:, None, :]
    ends = torch.cat([axes.mT, -axes.mT, torch.zeros_like(axes[:, :1])], dim=1)
    points = (means[:, None, :] + ends).reshape(-1, 3)
    # Opacities may all be zero; a floor keeps the weights' sum above it.
    weights = gaussians.opacities.detach().cpu().double().clamp_min(1e-6)
    return points, weights.repeat_interleave(ends.shape[1])


def _extent(
    points: Float[Tensor, "point axis"], weights: Float[Tensor, " point"]
) -> tuple[Float[Tensor, " axis"], Float[Tensor, " axis"]]:
    """Weighted quantiles TAIL and 1 - TAIL of each column."""
    order = points.argsort(dim=0)
    share = weights[order].cumsum(0) / weights.sum()
    values = points.gather(0, order)
    last = len(points) - 1
    low = (share < TAIL).sum(0).clamp_max(last)
    high = (share < 1 - TAIL).sum(0).clamp_max(last)
    return values.gather(0, low[None])[0], values.gather(0, high[None])[0]


def _principal_axes(
    centered: Float[Tensor, "point 3"], weights: Float[Tensor, " point"]
) -> Float[Tensor, "3 3"]:
    """Right-handed principal axes as columns, longest spread first, signs fixed."""
    covariance = (weights[:, None] * centered).mT @ centered / weights.sum()
    axes = torch.linalg.eigh(covariance)[1].flip(1)
    largest = axes.abs().argmax(dim=0, keepdim=True)
    axes = axes * axes.gather(0, largest).sign()
    third = torch.linalg.cross(axes[:, 0], axes[:, 1])
    return torch.stack([axes[:, 0], axes[:, 1], third], dim=1)


def _floats(values: Any, count: int) -> Any:
    """Exactly `count` finite numbers as a tuple of floats."""
    numbers = tuple(number(value) for value in values)
    if len(numbers) != count or not all(abs(each) <= LARGEST for each in numbers):
        raise ValueError(f"wanted {count} finite numbers, got {reprlib.repr(values)}")
    return numbers


def _whole_numbers(values: Any, count: int) -> Any:
    """Exactly `count` whole numbers as a tuple."""
    if len(values) != count:
        raise ValueError(f"wanted {count} whole numbers, got {reprlib.repr(values)}")
    return tuple(whole_number(value) for value in values)


def _share(value: Any) -> float:
    if not 0 <= number(value) <= 1:
        raise ValueError(f"{reprlib.repr(value)} is no number in [0, 1]")
    return number(value)
