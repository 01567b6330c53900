"""Which places of objects are worth saying: the few that tell where each stands, by boxes alone."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from instok3d.semantics.query.relations import UprightBoxes, relation

SAID = 0.5
"""A place is said where its relation of boxes is at least so true."""
MOST_NEAR = 2
"""Of the other things that each thing is said to be next to."""
HELD = 0.8
"""Likewise share of its box that lies in another one, for what is in it."""
THIN = 0.2
"""An upright thing whose width is less than this share of its length is thin, as walls are."""
LOW = 0.4
"""What reaches around most things and is less high than this share of its longest level side is
something to stand on: a floor, also one that is tilted because up is not known well."""


AS_LOW = 0.1
"""Share of a thing's height up to which another one begins as low as it does."""


@dataclass(frozen=True)
class SaidRelation:
    """A place of one thing by another one."""

    subject: int
    """Number of the thing among the boxes."""
    kind: str
    """on, in, above, under, against or next to."""
    other: int
    fit: float
    """How true it is, by the boxes, [0, 1]."""


def said_relations(boxes: UprightBoxes, walls: Bool[Tensor, " object"]) -> tuple[SaidRelation, ...]:
    """The places to say, in the order of their subjects; each pair of things has one at most.

    A thing is on one other thing, or else in, above or under one; against one wall; and next to
    two others at most, the nearest. What reaches around most of the others, such as all walls as
    one thing, is no place by which they could be told apart; a low one is still to stand on.

    Args:
        boxes: Of all things.
        walls: Which of them are walls, as far as that is known.
    """
    if len(boxes.low) < 2:
        return ()
    rooms, thin = surrounding(boxes), _thin(boxes.size)
    low = boxes.size[:, 2] < LOW * boxes.size[:, :2].amax(dim=1)
    walls = (walls | thin) & ~rooms
    things = ~rooms & ~walls

    def fits(kind: str, subjects: Tensor, others: Tensor) -> Float[Tensor, "object object"]:
        return relation(kind, boxes) * (subjects[:, None] & others[None])

    chosen = _Chosen([], set())
    chosen.say("on", fits("on", ~rooms, ~rooms | low))
    held = torch.zeros_like(rooms)
    held[[each.subject for each in chosen.found if not rooms[each.other]]] = True
    # What begins as low as the other one stands between its legs, else on one of its boards.
    as_low = boxes.low[:, None, 2] <= boxes.low[None, :, 2] + AS_LOW * boxes.size[None, :, 2]
    chosen.say("in", fits("in", ~rooms & ~held, things) * ~as_low, least=HELD)
    chosen.say("above", fits("above", things & ~held, things))
    covered = fits("under", things & ~held, things).minimum(_level_shares(boxes))
    chosen.say("under", covered * as_low)
    chosen.say("against", fits("against", things, walls))
    # Of several that touch, the one whose middle is nearest.
    apart = (boxes.center[:, None] - boxes.center[None]).norm(dim=2)
    near = fits("next to", things, things) - 1e-3 * apart / apart.max().clamp_min(1e-9)
    chosen.say("next to", near, most=MOST_NEAR)
    return tuple(sorted(chosen.found, key=lambda each: each.subject))


@dataclass(frozen=True)
class _Chosen:
    found: list[SaidRelation]
    paired: set[frozenset[int]]

    def say(
        self,
        kind: str,
        fits: Float[Tensor, "object object"],
        *,
        most: int = 1,
        least: float = SAID,
    ) -> None:
        """Take the truest of a kind for each subject, of pairs of which nothing is said yet."""
        for subject, row in enumerate(fits.tolist()):
            best = sorted(range(len(row)), key=lambda other: (-row[other], other))
            free = [other for other in best if frozenset((subject, other)) not in self.paired]
            for other in free[:most]:
                if row[other] >= least:
                    self.paired.add(frozenset((subject, other)))
                    self.found.append(SaidRelation(subject, kind, other, row[other]))


def _level_shares(boxes: UprightBoxes) -> Float[Tensor, "object object"]:
    """Share of each box that lies within each other one, seen from above."""
    low = torch.maximum(boxes.low[:, None, :2], boxes.low[None, :, :2])
    high = torch.minimum(boxes.high[:, None, :2], boxes.high[None, :, :2])
    own = boxes.size[:, None, :2].clamp_min(1e-9)
    return ((high - low).clamp_min(0) / own).clamp(max=1).prod(dim=-1)


def surrounding(boxes: UprightBoxes) -> Bool[Tensor, " object"]:
    """Which things reach around the middles of most others, seen from above, three at least."""
    middle = boxes.center[:, None, :2]
    within = (middle >= boxes.low[None, :, :2]) & (middle <= boxes.high[None, :, :2])
    held = within.all(dim=-1).fill_diagonal_(False).sum(dim=0)
    return (held >= 3) & (2 * held > len(boxes.low) - 1)


def _thin(size: Float[Tensor, "object 3"]) -> Bool[Tensor, " object"]:
    """Which things are upright and thin, as walls and doors are."""
    level = size[:, :2]
    thin = level.amin(dim=1) < THIN * level.amax(dim=1)
    return thin & (size[:, 2] > level.amin(dim=1)) & (size[:, 2] > THIN * level.amax(dim=1))
