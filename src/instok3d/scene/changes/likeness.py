"""Whether an object of one capture and one of another may be the same thing, wherever they are."""

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.scene.changes.traits import COLOR_SPREAD, Traits

SAME = (-0.5, 4.4, 4.05, -6.95)
"""Weights of colour, embedding and marks, and the constant: of a logistic regression on
pairs of objects of training rooms (docs/log.md)."""
MOST_COLOR = 3.0
UNKNOWN = 0.85
"""Cosine of embeddings between the usual one of the same thing and of others: of objects of which
no encoder that saw both captures knows anything."""
MATCHED, FEWEST = 0.6, 3
"""Cosine from which on marks of two objects show one place of a thing; how many must, to say how
far it moved."""


def looks_alike(first: Traits, second: Traits) -> Float[Tensor, "object other"]:
    """Mean cosine of marks and their nearest like in another object, both ways; 0 of none."""
    cosine = first.marks.looks @ second.marks.looks.mT
    found = torch.zeros(len(first.objects), len(second.objects), dtype=torch.float64)
    for row in range(len(first.objects)):
        own = cosine[first.marks.owners == row]
        for other in range(len(second.objects)):
            both = own[:, second.marks.owners == other]
            if both.numel():
                found[row, other] = (both.amax(1).mean() + both.amax(0).mean()) / 2
    return found


def same_thing(
    first: Traits, second: Traits, alike: Float[Tensor, "object other"]
) -> Float[Tensor, "object other"]:
    """Probability that two objects are the same thing.

    Args:
        first: Of one capture.
        second: Of another.
        alike: What `looks_alike` says of them.
    """
    color, embedding, marks, constant = SAME
    apart = (first.colors[:, None] - second.colors[None]).norm(dim=2) / COLOR_SPREAD
    score = color * apart.clamp_max(MOST_COLOR) + marks * alike + constant
    cosines = [
        torch.where(one.any(dim=1)[:, None] & other.any(dim=1)[None], one @ other.T, UNKNOWN)
        for name in first.embeddings.keys() & second.embeddings.keys()
        if (one := first.embeddings[name]).shape[1] == (other := second.embeddings[name]).shape[1]
    ]
    middle = torch.stack(cosines).mean(dim=0) if cosines else UNKNOWN
    return (score + embedding * middle).sigmoid()


def way(first: Traits, second: Traits, row: int, other: int) -> Float[Tensor, "3"]:
    """How far an object is from where it was: of its matched marks, else of its centroid.

    Marks are the better ones, since captures that show different parts of a thing have centroids
    of different places.
    """
    own, there = first.marks.owners == row, second.marks.owners == other
    cosine = first.marks.looks[own] @ second.marks.looks[there].mT
    if cosine.numel():
        best, forth = cosine.max(dim=1)
        mutual = cosine.argmax(dim=0)[forth] == torch.arange(len(forth))
        mutual &= best >= MATCHED
        if int(mutual.sum()) >= FEWEST:
            ways = second.marks.positions[there][forth] - first.marks.positions[own]
            return ways[mutual].median(dim=0).values
    return second.centers[other] - first.centers[row]
