"""The words of a room's instances, from what its shard says of them."""

from collections.abc import Mapping
from typing import Any

from instok3d.data.words import ObjectWords
from instok3d.reading import text, whole_number

NO_MATERIAL = ("unknown", "wall", "floor")
"""What the catalogue's textures say instead of a material."""


def stored_words(meta: Mapping[str, Any]) -> dict[int, ObjectWords]:
    """Words of each instance id, as the generator stored them; none of what it did not say.

    The colour is that of the largest material without light, not the one that is seen.

    Raises:
        ValueError: A value is of another kind, or an id stands twice.
    """
    words: dict[int, ObjectWords] = {}
    for record in meta.get("instances", ()):
        if not {"id", "class"} <= record.keys():
            continue
        number = whole_number(record["id"], 1)
        if number in words:
            raise ValueError(f"two instances of seed {meta['seed']} have the id {number}")
        material = text(record.get("material", ""))
        words[number] = ObjectWords(
            label=text(record["class"]),
            color=text(record.get("color", "")),
            material="" if material in NO_MATERIAL else material,
        )
    return words
