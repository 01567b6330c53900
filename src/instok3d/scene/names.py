"""Names of objects: labels, who gave them, and the keys made of them."""

import reprlib
from typing import Any

from instok3d.reading import text

MAX_LABEL = 100
"""Characters of a label."""
UNLABELLED = "object"
"""Stands in the key of an object without a label."""
USER, FILE, SEMANTICS = "user", "given", "semantics:"
"""Sources of labels: a person's rename; an imported file, or an older program that did not say; the
beginning of those that an encoder gave."""


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


def read_label_source(value: Any) -> str | None:
    """Who named the object of an entry; versions before 3 say "given" alone."""
    source, label = value.get("label_source"), value.get("label")
    if label is None:
        if source is not None:
            raise ValueError(f"there is no label, but its source {reprlib.repr(source)}")
        return None
    if source is None:  # scene folders of versions 1 to 3
        return FILE
    return check_label_source(text(source))
