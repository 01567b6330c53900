"""What a scene says of each of its objects: where it is, how large, where it is seen best."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.rotations import matrix_to_quat, quat_to_matrix
from instok3d.types import Gaussians

Point = tuple[float, float, float]
TAIL = 0.02
"""Share of an object's opacity that a box leaves out on each side of each axis: haze and strays."""


@dataclass(frozen=True)
class AlignedBox:
    """A box along the axes of the world."""

    min: Point
    max: Point


@dataclass(frozen=True)
class OrientedBox:
    """A box along the object's own principal axes."""

    center: Point
    size: Point
    """Full lengths along the box's axes, longest spread first."""
    quat_wxyz: tuple[float, float, float, float]
    """Rotation world_from_box."""


@dataclass(frozen=True)
class BestView:
    """The input view that shows most of an object."""

    view: int
    """Index of the input view."""
    bbox: tuple[int, int, int, int]
    """x0, y0, x1, y1 in pixels of the view at the scene's size; x1 and y1 are exclusive."""
    pixels: int


@dataclass(frozen=True)
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
    """Mean of the group's composited map over the input pixels that it wins, in [0, 1]."""
    visible_in: tuple[int, ...]
    """Input views in which it wins enough pixels."""
    best_view: BestView
    label: str | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain values for objects.json."""
        return asdict(self)

    @staticmethod
    def from_json(value: Any) -> "SceneObject":
        """The object of an entry of objects.json; unknown keys are ignored.

        Raises:
            KeyError, TypeError, ValueError: An entry is missing or of the wrong kind.
        """
        return SceneObject(
            id=int(value["id"]),
            key=str(value["key"]),
            color=str(value["color"]),
            aabb=AlignedBox(_floats(value["aabb"]["min"], 3), _floats(value["aabb"]["max"], 3)),
            obb=OrientedBox(
                center=_floats(value["obb"]["center"], 3),
                size=_floats(value["obb"]["size"], 3),
                quat_wxyz=_floats(value["obb"]["quat_wxyz"], 4),
            ),
            centroid=_floats(value["centroid"], 3),
            num_anchors=int(value["num_anchors"]),
            num_gaussians=int(value["num_gaussians"]),
            gaussian_range=_ints(value["gaussian_range"], 2),
            confidence=_floats([value["confidence"]], 1)[0],
            visible_in=tuple(int(view) for view in value["visible_in"]),
            best_view=BestView(
                view=int(value["best_view"]["view"]),
                bbox=_ints(value["best_view"]["bbox"], 4),
                pixels=int(value["best_view"]["pixels"]),
            ),
            label=None if value.get("label") is None else str(value["label"]),
        )


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
    """Exactly `count` finite floats as a tuple."""
    numbers = tuple(float(value) for value in values)
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        raise ValueError(f"wanted {count} finite numbers, got {values}")
    return numbers


def _ints(values: Any, count: int) -> Any:
    """Exactly `count` integers as a tuple."""
    numbers = tuple(int(value) for value in values)
    if len(numbers) != count:
        raise ValueError(f"wanted {count} whole numbers, got {values}")
    return numbers
