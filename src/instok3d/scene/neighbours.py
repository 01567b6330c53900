"""With whom an object shares its surface: the objects that it may be a part of, or stands on."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.scene.contacts import Contacts, find_contacts

MIN_SHARE = 0.02
"""Of an object's border: a neighbour along less of it is none."""


@dataclass(frozen=True)
class Neighbour:
    """Another object that touches one."""

    id: int
    share: float
    """Of the object's border in the input views: where the surface goes on as that of the other
    one, without a jump in depth."""


def as_values(neighbours: Sequence[Neighbour]) -> list[dict[str, Any]]:
    """Neighbours in plain values, as objects.json has them."""
    return [asdict(each) for each in neighbours]


def find_neighbours(
    ids: Int[Tensor, "view height width"],
    depths: Float[Tensor, "view height width"],
    objects: Sequence[int],
) -> dict[int, tuple[Neighbour, ...]]:
    """The neighbours of each object, those along most of its border first.

    Borders with the rest of the scene count as border, but the rest is no neighbour; nor do the
    edges of the pictures count.

    Args:
        ids: Which object each pixel shows, 0 for none.
        depths: z-depth, 0 for nothing.
        objects: Ids to look at; others count as the rest.
    """
    number = {each: index + 1 for index, each in enumerate(objects)}
    count = len(objects) + 1
    regions = torch.zeros_like(ids)
    for each, index in number.items():
        regions[ids == each] = index
    total = Contacts(torch.zeros(count, count), torch.zeros(count, count))
    for region, depth in zip(regions, depths, strict=True):
        total += find_contacts(region, region, depth, count, count)
    shares = total.surface / total.border.sum(dim=1, keepdim=True).clamp_min(1)
    found: dict[int, tuple[Neighbour, ...]] = {}
    for each, index in number.items():
        row = shares[index, 1:].tolist()
        touching = [Neighbour(other, share) for other, share in zip(objects, row, strict=True)
                    if share >= MIN_SHARE]  # fmt: skip
        found[each] = tuple(sorted(touching, key=lambda item: (-item.share, item.id)))
    return found
