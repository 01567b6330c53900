"""Sizes and places of objects, by their boxes alone: nothing here is embedded or learnt.

Boxes stand upright: two axes are level, the third is up. Relations are numbers in [0, 1], of every
object to every other one, without units: distances count relative to the sizes of the two.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

NEAR = 1.0
"""Reach of "next to", in geometric means of the longest level sides of the two things."""
TOUCHING = 0.25
"""Likewise of "against" and of the levels of "above" and "under"."""
STANDING = 0.25
"""Of the mean side of a thing: how far its base may be above what it stands on."""


@dataclass(frozen=True)
class UprightBoxes:
    """Boxes of objects along two level axes and up, scene units."""

    low: Float[Tensor, "object 3"]
    """Least coordinates; the third axis points up."""
    high: Float[Tensor, "object 3"]

    @property
    def size(self) -> Float[Tensor, "object 3"]:
        """Full lengths."""
        return self.high - self.low

    @property
    def center(self) -> Float[Tensor, "object 3"]:
        """Middles."""
        return (self.high + self.low) / 2


ORDER_KEYS: dict[str, Callable[[UprightBoxes], Tensor]] = {
    "largest": lambda boxes: boxes.size.prod(dim=1),
    "smallest": lambda boxes: -boxes.size.prod(dim=1),
    "tallest": lambda boxes: boxes.size[:, 2],
    "shortest": lambda boxes: -boxes.size[:, 2],
    "longest": lambda boxes: boxes.size[:, :2].amax(dim=1),
    "highest": lambda boxes: boxes.center[:, 2],
    "lowest": lambda boxes: -boxes.center[:, 2],
}
"""By the orders of the grammar: what is largest of the object that is meant."""


def gaps(boxes: UprightBoxes) -> Float[Tensor, "object object"]:
    """Distance of every two boxes, 0 where they overlap."""
    return _axis_gaps(boxes).norm(dim=2)


def relation(kind: str, boxes: UprightBoxes) -> Float[Tensor, "object object"]:
    """How well each object (row) has a place relative to each other one (column), in [0, 1].

    Args:
        kind: next to, against, on, above, under, in, nearest or farthest. The last two compare
            objects, so that they are 1 for the nearest or farthest of all and less for the others.
        boxes: Of all objects.
    """
    found = RELATIONS[kind](boxes)
    return found.fill_diagonal_(0.0)


def between(boxes: UprightBoxes) -> Float[Tensor, "object object object"]:
    """How well each object lies between every two others, in [0, 1].

    1 on the line between the middles, seen from above, in its inner 80 %; less to the sides.
    """
    middle = boxes.center[:, :2]
    start, end = middle[None, :, None], middle[None, None, :]
    line = end - start
    length = line.norm(dim=-1).clamp_min(1e-9)
    along = ((middle[:, None, None] - start) * line).sum(-1) / length**2
    foot = start + along[..., None] * line
    aside = (middle[:, None, None] - foot).norm(dim=-1) / length
    inner = ((along - 0.1).minimum(0.9 - along) >= 0).float()
    found = inner * (1 - 2 * aside).clamp(0, 1)
    own = torch.eye(len(middle), dtype=torch.bool)
    return found.masked_fill(own[:, :, None] | own[:, None, :] | own[None], 0.0)


def _axis_gaps(boxes: UprightBoxes) -> Float[Tensor, "object object 3"]:
    """Distance along each axis, 0 where they overlap along it."""
    low, high = boxes.low, boxes.high
    return torch.maximum(low[:, None] - high[None], low[None] - high[:, None]).clamp_min(0)


def _reach(boxes: UprightBoxes) -> Float[Tensor, "object object"]:
    """Geometric means of the longest level sides."""
    side = boxes.size[:, :2].amax(dim=1).clamp_min(1e-9)
    return (side[:, None] * side[None]).sqrt()


def _next_to(boxes: UprightBoxes) -> Tensor:
    return (1 - gaps(boxes) / (NEAR * _reach(boxes))).clamp(0, 1)


def _against(boxes: UprightBoxes) -> Tensor:
    return (1 - gaps(boxes) / (TOUCHING * _reach(boxes))).clamp(0, 1)


def _level(boxes: UprightBoxes) -> Tensor:
    """Whether two things overlap as seen from above, or nearly."""
    aside = _axis_gaps(boxes)[..., :2].norm(dim=2)
    return (1 - aside / (TOUCHING * _reach(boxes))).clamp(0, 1)


def _held(boxes: UprightBoxes, axes: int) -> Tensor:
    """Share of each box that lies within each other one, along the first axes."""
    low = torch.maximum(boxes.low[:, None], boxes.low[None])[..., :axes]
    high = torch.minimum(boxes.high[:, None], boxes.high[None])[..., :axes]
    own = boxes.size[:, None, :axes].clamp_min(1e-9)
    return ((high - low).clamp_min(1e-9 * (high >= low)).clamp_min(0) / own).clamp(0, 1).prod(-1)


def _on(boxes: UprightBoxes) -> Tensor:
    """Above, and standing on it: or hanging on what is upright and thin, such as a wall.

    The base may lie below the other's highest point, as on the seat of a chair, but not below the
    middle of the other one.
    """
    base, top = boxes.low[:, None, 2], boxes.high[None, :, 2]
    over = base - top
    margin = STANDING * boxes.size.mean(dim=1)[:, None].clamp_min(1e-9)
    half = (boxes.size[None, :, 2] / 2).clamp_min(1e-9)
    stands = torch.where(over >= 0, 1 - over / margin, 1 + over / torch.maximum(half, margin))
    held = (2 * _held(boxes, 2)).clamp(max=1)
    standing = stands.clamp(0, 1) * held
    level = boxes.size[:, :2]
    thin = level.amin(dim=1) < 0.2 * level.amax(dim=1)
    wall = (thin & (boxes.size[:, 2] > level.amin(dim=1)))[None]
    within = (base >= boxes.low[None, :, 2]) & (boxes.high[:, None, 2] <= top + margin)
    hanging = _against(boxes) * (wall & within & (base > boxes.low[None, :, 2] + half / 5))
    return torch.maximum(standing, hanging)


def _above(boxes: UprightBoxes) -> Tensor:
    middle = boxes.center[None, :, 2]
    half = (boxes.size[None, :, 2] / 2).clamp_min(1e-9)
    return ((boxes.low[:, None, 2] - middle) / half).clamp(0, 1) * _level(boxes)


def _under(boxes: UprightBoxes) -> Tensor:
    half = (boxes.size[None, :, 2] / 2).clamp_min(1e-9)
    lower = ((boxes.high[None, :, 2] - boxes.high[:, None, 2]) / half).clamp(0, 1)
    return lower * _level(boxes)


def _in(boxes: UprightBoxes) -> Tensor:
    return _held(boxes, 3)


def _nearest(boxes: UprightBoxes) -> Tensor:
    """1 / (1 + distance), boxes first, middles where they overlap: an order, not a probability."""
    return 1 / (1 + _distance(boxes))


def _farthest(boxes: UprightBoxes) -> Tensor:
    distance = _distance(boxes)
    return distance / (1 + distance)


def _distance(boxes: UprightBoxes) -> Tensor:
    apart = (boxes.center[:, None] - boxes.center[None]).norm(dim=2)
    return gaps(boxes) + 1e-3 * apart


RELATIONS: dict[str, Callable[[UprightBoxes], Tensor]] = {
    "next to": _next_to, "against": _against, "on": _on, "above": _above, "under": _under,
    "in": _in, "nearest": _nearest, "farthest": _farthest,
}  # fmt: skip
