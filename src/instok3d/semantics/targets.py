"""What a perfect teacher would say of a scene whose words are known."""

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

from instok3d.data.words import ObjectWords
from instok3d.semantics.text import TextTable

COLOR_WEIGHT, MATERIAL_WEIGHT = 0.5, 0.25
"""Of the words beside the class, whose weight is 1."""


def target_vectors(
    words: Mapping[int, ObjectWords], table: TextTable
) -> dict[int, Float[Tensor, " channel"]]:
    """A unit vector for each instance: class + 1/2 colour + 1/4 material, normalised.

    Raises:
        ValueError: The table knows none of the pieces of a word.
    """
    return {number: _vector(each, table) for number, each in words.items() if each.label}


def target_map(
    instances: Int[Tensor, "*view height width"],
    words: Mapping[int, ObjectWords],
    table: TextTable,
) -> tuple[Float[Tensor, "*view channel height width"], Bool[Tensor, "*view height width"]]:
    """The vector of every pixel's instance, and which pixels have one; the others are 0.

    Pixels that are ignored (-1), of no instance (0) or of one without words have none.
    """
    vectors = target_vectors(words, table)
    ids, places = instances.unique(return_inverse=True)
    rows = torch.zeros(len(ids), table.rows.shape[1])
    for row, number in enumerate(ids.tolist()):
        if number in vectors:
            rows[row] = vectors[number]
    rows = rows.to(instances.device)
    return rows[places].movedim(-1, -3), rows.any(dim=1)[places]


def _vector(words: ObjectWords, table: TextTable) -> Float[Tensor, " channel"]:
    weighted = ((words.label, 1.0), (words.color, COLOR_WEIGHT), (words.material, MATERIAL_WEIGHT))
    known = [(text, weight) for text, weight in weighted if text]
    embedded = table.embed([text for text, _ in known])
    weights = torch.tensor([weight for _, weight in known])
    return functional.normalize(weights @ embedded, dim=0)
