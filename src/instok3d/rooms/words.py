"""The words of a room's instances, from what its shard says of them."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from instok3d.data.words import ObjectWords
from instok3d.reading import text, whole_number

NO_MATERIAL = ("unknown", "wall", "floor")
"""What the catalogue's textures say instead of a material."""
SHOWS_OTHERS = ("window", "mirror")
"""Classes whose pixels have the colours of something else; their colour is that of the frame."""


def with_seen_colors(
    words: Mapping[int, ObjectWords], seen: Mapping[int, str]
) -> dict[int, ObjectWords]:
    """The words with the colours that pictures show, where these are the thing's own."""
    return {
        number: each
        if each.label in SHOWS_OTHERS
        else replace(each, color=seen.get(number, each.color))
        for number, each in words.items()
    }


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
