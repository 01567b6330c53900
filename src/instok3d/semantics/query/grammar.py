"""What a question asks for: a thing, its colour, material, size order and place, one or all.

    question    = [opening] ["all" | number] description [ending]
    description = {article | colour | material | order} noun [place description]
                | "something" purpose

Colours, materials, orders and places are words of `vocabulary`; the noun is all that remains, and
is embedded. "lamp on the desk next to the window" is a lamp on (a desk next to a window).
"""

import re
import reprlib
from dataclasses import dataclass

from instok3d.semantics.query.vocabulary import (
    ALL,
    ALWAYS_PLURAL,
    ARTICLES,
    COLORS,
    ENDINGS,
    EXTREMES,
    FILLERS,
    GENERIC,
    LINKS,
    MATERIALS,
    NUMBERS,
    OPENINGS,
    ORDERS,
    PLACES,
    PURPOSES,
    REFUSED,
    SHADES,
)

MAX_TEXT = 500
"""Characters of a question."""
MAX_PLACES = 3
"""Places of a question, one within the other."""


class NotUnderstoodError(ValueError):
    """A question is none of the grammar; says in one sentence why."""


@dataclass(frozen=True)
class Relation:
    """A place, by other things."""

    kind: str
    """A value of PLACES, or "nearest", "farthest"."""
    others: tuple["Description", ...]
    """One; two of "between"."""

    def words(self) -> str:
        """The place in words."""
        others = " and ".join(f"({other.words()})" for other in self.others)
        joint = {"nearest": "nearest to", "farthest": "farthest from"}.get(self.kind, self.kind)
        return f"{joint} {others}"


@dataclass(frozen=True)
class Description:
    """A thing as it is described."""

    noun: str
    """What is embedded; empty where any object may be meant."""
    colors: tuple[str, ...] = ()
    """Of the 13 names."""
    materials: tuple[str, ...] = ()
    order: str | None = None
    """A value of ORDERS: the first in it is meant."""
    place: Relation | None = None

    def words(self) -> str:
        """What was understood, in words."""
        parts = [f"like {self.noun!r}" if self.noun else "any object"]
        parts += [f"colour {' and '.join(self.colors)}"] if self.colors else []
        parts += [f"of {' and '.join(self.materials)}"] if self.materials else []
        parts += [self.place.words()] if self.place else []
        parts += [f"the {self.order} of them"] if self.order else []
        return ", ".join(parts)


@dataclass(frozen=True)
class Question:
    """A question that was understood."""

    text: str
    thing: Description
    several: bool = False
    """All that are meant, not the one that is most likely."""
    count: int | None = None
    """So many of them."""

    def words(self) -> str:
        """What was understood, in words."""
        number = "one object" if not self.several else "all objects"
        number = number if self.count is None else f"{self.count} objects"
        return f"{number} {self.thing.words()}".replace("object any object", "object").replace(
            "objects any object", "objects"
        )


def understand(text: str) -> Question:
    """What a question asks for.

    Raises:
        NotUnderstoodError: It is empty, or none of the grammar.
    """
    words = _words(text)
    words = _without_ends(words)
    several, count, words = _number(words)
    thing, plural = _description(words, MAX_PLACES)
    several = several or (plural and thing.order is None)
    if several and thing.order is not None:
        raise NotUnderstoodError(
            f"{thing.order!r} is one of several: ask for all of them, or for the {thing.order} one"
        )
    return Question(text.strip(), thing, several, count)


def _words(text: str) -> list[str]:
    if not isinstance(text, str) or not text.strip():
        raise NotUnderstoodError(
            "the question is empty: name a thing, such as 'chair' or 'the lamp on the desk'"
        )
    if len(text) > MAX_TEXT:
        raise NotUnderstoodError(
            f"the question has {len(text)} characters, at most {MAX_TEXT} are read: name a thing"
        )
    found = re.findall(r"\w+(?:['’]\w+)*", text.lower().replace("_", " "))
    if not found:
        raise NotUnderstoodError(f"there is no word in {reprlib.repr(text)}: name a thing")
    return [word.replace("’", "'") for word in found]


def _without_ends(words: list[str]) -> list[str]:
    """The words without "show me" and "in the room"."""
    again = True
    while again:
        again = False
        for opening in OPENINGS:
            if tuple(words[: len(opening)]) == opening and len(words) > len(opening):
                words, again = words[len(opening) :], True
        for ending in ENDINGS:
            if tuple(words[-len(ending) :]) == ending and len(words) > len(ending):
                words, again = words[: -len(ending)], True
    return words


def _number(words: list[str]) -> tuple[bool, int | None, list[str]]:
    """Whether several are asked for, how many, and the other words."""
    place = 0
    several, count = False, None
    while place < len(words) - 1:
        word = words[place]
        if word in ALL:
            several = True
        elif word in NUMBERS or (word.isdecimal() and int(word) > 0):
            count = NUMBERS.get(word) or int(word)
            several = count > 1
        elif word not in ARTICLES and (word != "of" or not place):
            break
        place += 1
    return several, count, words[place:]


def _description(words: list[str], places: int) -> tuple[Description, bool]:
    """A thing, and whether it is plural."""
    purpose = _purpose(words)
    if purpose is not None:
        return Description(purpose), False
    start, kind, length = _first_place(words)
    place = None
    own = words[:start]
    if kind is not None:
        if not places:
            raise NotUnderstoodError(
                f"at most {MAX_PLACES} places are understood, one within the other: ask for less"
            )
        own, place = _with_place(own, kind, words[start + length :], places - 1)
    while own and own[-1] in LINKS:
        own = own[:-1]
    _refuse(own)
    return _thing(own, place)


def _purpose(words: list[str]) -> str | None:
    """What a thing is for, where it is described by that."""
    at = [number for number, word in enumerate(words[:3]) if word in GENERIC]
    if not at or at[0] + 2 > len(words) - 1 or words[at[0] + 1] not in PURPOSES:
        return None
    rest = words[at[0] + 1 :]
    # "something that is on the desk" is a place, not a purpose.
    if rest[0] in ("that", "which") and rest[1] in LINKS:
        return None
    return " ".join([words[at[0]], *rest])


def _first_place(words: list[str]) -> tuple[int, str | None, int]:
    """Where the first place begins, its kind, and how many words name it."""
    for start, word in enumerate(words):
        if word in EXTREMES:
            return start, EXTREMES[word], 1
        for names, kind in PLACES.items():
            end = start + len(names)
            # Behind it stands the other thing, without which it is none: "something to sit on".
            if tuple(words[start:end]) == names and end < len(words):
                return start, kind, len(names)
    return len(words), None, 0


def _with_place(
    before: list[str], kind: str, behind: list[str], places: int
) -> tuple[list[str], Relation]:
    """The words of the thing itself, and its place."""
    if kind in EXTREMES.values():
        joint = "to" if kind == "nearest" else "from"
        if joint in behind:  # "the nearest chair to the window", "the chair nearest to the window"
            at = behind.index(joint)
            before, behind = before + behind[:at], behind[at + 1 :]
        elif not [word for word in before if word not in ARTICLES] or not behind:
            raise NotUnderstoodError(
                f"{kind!r} needs a thing to measure from, such as 'the chair {kind} {joint} the "
                "window'"
            )
        return before, Relation(kind, (_other(behind, kind, places),))
    if kind != "between":
        return before, Relation(kind, (_other(behind, kind, places),))
    if behind.count("and") != 1:
        raise NotUnderstoodError(
            "'between' takes two things, such as 'between the bed and the window'"
        )
    at = behind.index("and")
    parts = (behind[:at], behind[at + 1 :])
    return before, Relation(kind, tuple(_other(part, kind, places) for part in parts))


def _other(words: list[str], kind: str, places: int) -> Description:
    thing, _ = _description(words, places)
    if not thing.noun and not thing.colors and not thing.materials and thing.order is None:
        raise NotUnderstoodError(f"{kind!r} needs another thing, such as '{kind} the window'")
    return thing


def _refuse(words: list[str]) -> None:
    if "many" in words:  # "how many"
        raise NotUnderstoodError(REFUSED["many"])
    for number, word in enumerate(words):
        # "the front door" and "the right chair" are things, "right of" and "in front of" places.
        if word in ("right", "front") and words[number + 1 : number + 2] == ["of"]:
            raise NotUnderstoodError(REFUSED["left"].format(word=word))
        both = word == "and" and 0 < number < len(words) - 1
        if both and words[number - 1] in COLORS and words[number + 1] in COLORS:
            continue  # "the black and white chair"
        if word in REFUSED:
            raise NotUnderstoodError(REFUSED[word].format(word=word))


def _thing(words: list[str], place: Relation | None) -> tuple[Description, bool]:
    """The description of words without places, and whether the noun is plural."""
    colors: list[str] = []
    materials: list[str] = []
    orders: list[str] = []
    noun: list[str] = []
    for number, word in enumerate(words):
        behind = words[number + 1 :]
        if word in COLORS:
            colors.append(COLORS[word])
        elif word in MATERIALS and any(each not in COLORS for each in behind):
            materials.append(MATERIALS[word])
        elif word in ORDERS:
            orders.append(ORDERS[word])
        elif word in FILLERS or (word == "and" and colors):
            continue  # "the black and white chair"
        elif word in SHADES and behind and behind[0] in COLORS:
            continue
        elif word not in ARTICLES:
            noun.append(word)
    if len(set(orders)) > 1:
        raise NotUnderstoodError(
            f"{orders[0]!r} and {orders[1]!r} are two orders: ask for one of them"
        )
    if not noun and not colors and not materials and not orders and place is None:
        raise NotUnderstoodError(
            f"no thing is named in {' '.join(words)!r}: name one, such as 'chair'"
        )
    generic = all(word in GENERIC for word in noun)
    head = noun[noun.index("of") - 1] if "of" in noun[1:] else noun[-1] if noun else ""
    plural = is_plural(head)
    named = "" if generic else " ".join(
        singular(word) if word == head and plural else word for word in noun
    )  # fmt: skip
    found = Description(
        named, tuple(dict.fromkeys(colors)), tuple(dict.fromkeys(materials)),
        orders[0] if orders else None, place,
    )  # fmt: skip
    return found, plural or (generic and "everything" in noun)


def is_plural(word: str) -> bool:
    """Whether a noun names several things."""
    ends = ("ss", "us", "is")
    return len(word) > 3 and word.endswith("s") and word not in ALWAYS_PLURAL and not (
        word.endswith(ends)
    )  # fmt: skip


def singular(word: str) -> str:
    """One of what a plural names."""
    if word.endswith("shelves"):
        return word[:-3] + "f"
    if word.endswith("ies") and len(word) > 4:
        return word[:-3] + "y"
    if word.endswith(("sses", "xes", "ches", "shes")):
        return word[:-2]
    return word[:-1]
