"""Where Gaussians are and how large: boxes, centroid, extents; without faint strays."""

import math
import reprlib
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.rotations import matrix_to_quat, quat_to_matrix
from instok3d.reading import number
from instok3d.types import MAX_LENGTH, Gaussians

Point = tuple[float, float, float]
LARGEST = 100 * MAX_LENGTH
"""What a coordinate or a length can be: of boxes about the largest Gaussians."""
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
        box = AlignedBox(finite_numbers(value["min"], 3), finite_numbers(value["max"], 3))
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
        center, size = finite_numbers(value["center"], 3), finite_numbers(value["size"], 3)
        quat = finite_numbers(value["quat_wxyz"], 4)
        if min(size) < 0:
            raise ValueError(f"the box has the size {size}")
        if abs(math.hypot(*quat) - 1) > 1e-3:
            raise ValueError(f"the quaternion {quat} is not of unit length")
        return OrientedBox(center, size, quat)


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
        center=finite_numbers((axes @ ((own_low + own_high) / 2)).tolist(), 3),
        size=finite_numbers((own_high - own_low).tolist(), 3),
        quat_wxyz=finite_numbers(matrix_to_quat(axes).tolist(), 4),
    )
    aligned = AlignedBox(finite_numbers(low.tolist(), 3), finite_numbers(high.tolist(), 3))
    return aligned, box, finite_numbers(center.tolist(), 3)


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


def finite_numbers(values: Any, count: int) -> Any:
    """Exactly `count` finite numbers as a tuple of floats."""
    numbers = tuple(number(value) for value in values)
    if len(numbers) != count or not all(abs(each) <= LARGEST for each in numbers):
        raise ValueError(f"wanted {count} finite numbers, got {reprlib.repr(values)}")
    return numbers
