"""Questions about rooms whose truth is known, and how often they are answered right.

For each room: its classes, their synonyms, colour and class, two things of one class in different
colours, places ("on", "next to", "nearest to"), sizes, and classes that are absent.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.data.words import ObjectWords
from instok3d.rooms.classes import CLASSES, STUFF
from instok3d.semantics.query.calibration import TRUE_SHARE, passing_threshold
from instok3d.semantics.query.relations import UprightBoxes, gaps

Kind = Literal["class", "synonym", "colour + class", "two colours", "place", "size", "absent"]
KINDS: tuple[Kind, ...] = (
    "class", "synonym", "colour + class", "two colours", "place", "size", "absent",
)  # fmt: skip

BROADER = {"side table": "table", "coffee table": "table", "ceiling lamp": "lamp",
           "shower curtain": "curtain", "armchair": "chair"}  # fmt: skip
"""Who asks for a table means a side table too; who asks for a side table means no table."""

SYNONYMS: Mapping[str, tuple[str, ...]] = {
    "armchair": ("easy chair",), "backpack": ("rucksack",), "bag": ("handbag",),
    "bathtub": ("tub",), "bed": ("mattress",), "books": ("novels",), "bookshelf": ("bookcase",),
    "bottle": ("flask",), "bowl": ("dish",), "box": ("carton",), "cabinet": ("cupboard",),
    "ceiling lamp": ("chandelier",), "chair": ("seat",), "clock": ("timepiece",),
    "clothes": ("garments",), "counter": ("worktop",), "cup": ("mug",), "curtain": ("drapes",),
    "desk": ("writing table",), "dresser": ("chest of drawers",), "lamp": ("light",),
    "laptop": ("notebook computer",), "mirror": ("looking glass",),
    "monitor": ("computer screen",), "nightstand": ("bedside table",), "ottoman": ("pouf",),
    "oven": ("stove", "cooker"), "paper": ("documents",), "picture": ("painting", "poster"),
    "pillow": ("cushion",), "plant": ("houseplant",), "printer": ("copier",),
    "radiator": ("heater",), "refrigerator": ("fridge",), "rug": ("carpet",), "shelf": ("rack",),
    "shoes": ("sneakers",), "sink": ("washbasin",), "sofa": ("couch", "settee"),
    "stool": ("barstool",), "suitcase": ("luggage",), "telephone": ("phone",),
    "television": ("tv",), "toilet": ("lavatory",), "towel": ("washcloth",),
    "trash can": ("garbage bin", "wastebasket"), "tv stand": ("media console",),
    "wardrobe": ("closet",), "washing machine": ("washer",),
}  # fmt: skip
"""Other words for classes, for tests alone: nothing is trained or calibrated on them."""

NEAR_M, APART_M = 0.3, 1.0
"""Metres: things next to each other are at most so far apart, things that are not at least so."""
LARGER = 1.5
"""Volume of the largest thing of a class over that of the second, or it is not asked for."""
ABSENT = 8
"""Absent classes that are asked for in each room."""


@dataclass(frozen=True)
class Thing:
    """An instance of a room that is seen well enough to be asked for."""

    words: ObjectWords
    low: tuple[float, ...]
    """x, y, z of its true box, metres, z up."""
    high: tuple[float, ...]
    parent: int
    """Index among the things of what it stands on, -1 for none of them."""


@dataclass(frozen=True)
class RoomQuestion:
    """A question with its truth."""

    kind: Kind
    text: str
    meant: frozenset[int]
    """Indices of things; empty: nothing is."""
    spared: frozenset[int] = frozenset()
    """Things that are neither right nor wrong, such as a table where a side table is asked for."""


def is_a(label: str, wanted: str) -> bool:
    """Whether who asks for one class means another one."""
    return label == wanted or BROADER.get(label) == wanted


def room_questions(things: Sequence[Thing], seed: int) -> list[RoomQuestion]:
    """The questions of a room, each once.

    Args:
        things: Of the room, stuff as well: it is not asked for, but may be answered wrongly.
        seed: Draws the absent classes.
    """
    labels = [thing.words.label for thing in things]
    objects = sorted({label for label in labels if label and label not in STUFF})
    questions = []
    for label in objects:
        meant, spared = _of_class(things, label)
        questions.append(RoomQuestion("class", label, meant, spared))
        questions += [
            RoomQuestion("synonym", word, meant, spared) for word in SYNONYMS.get(label, ())
        ]
        questions += _colored(things, label, spared)
        questions += _largest(things, label, spared)
    questions += _places(things)
    absent = [
        label for label in CLASSES
        if label not in STUFF and not any(map(any, zip(*_of_family(labels, label), strict=True)))
    ]  # fmt: skip
    order = torch.randperm(len(absent), generator=torch.Generator().manual_seed(seed)).tolist()
    chosen = [absent[place] for place in order[:ABSENT]]
    return questions + [RoomQuestion("absent", label, frozenset()) for label in chosen]


def _of_family(labels: Sequence[str], wanted: str) -> tuple[list[bool], list[bool]]:
    """Which labels are of a class, and which are only of the same family."""
    family = BROADER.get(wanted, wanted)
    meant = [is_a(label, wanted) for label in labels]
    return meant, [is_a(label, family) for label in labels]


def _of_class(things: Sequence[Thing], label: str) -> tuple[frozenset[int], frozenset[int]]:
    meant, family = _of_family([thing.words.label for thing in things], label)
    return (
        frozenset(i for i, each in enumerate(meant) if each),
        frozenset(i for i, each in enumerate(family) if each and not meant[i]),
    )


def _colored(things: Sequence[Thing], label: str, spared: frozenset[int]) -> list[RoomQuestion]:
    """Each colour of the things of a class; where there are several, the others must lose."""
    own = [i for i, thing in enumerate(things) if is_a(thing.words.label, label)]
    colors = sorted({things[i].words.color for i in own if things[i].words.color})
    kind: Kind = "two colours" if len(colors) > 1 else "colour + class"
    return [
        RoomQuestion(
            kind, f"the {color} {label}",
            frozenset(i for i in own if things[i].words.color == color), spared,
        )
        for color in colors
    ]  # fmt: skip


def _largest(things: Sequence[Thing], label: str, spared: frozenset[int]) -> list[RoomQuestion]:
    own = [i for i, thing in enumerate(things) if is_a(thing.words.label, label)]
    if len(own) < 2:
        return []
    volumes = [_volume(things[i]) for i in own]
    first, second = sorted(volumes, reverse=True)[:2]
    if first < LARGER * second:
        return []
    largest = frozenset({own[volumes.index(first)]})
    return [RoomQuestion("size", f"the largest {label}", largest, spared)]


def _volume(thing: Thing) -> float:
    x, y, z = (high - low for low, high in zip(thing.low, thing.high, strict=True))
    return x * y * z


def _places(things: Sequence[Thing]) -> list[RoomQuestion]:
    """Places that tell one thing of a class from others, or that only one thing has."""
    apart = gaps(boxes_of(things)).tolist()
    found: dict[str, RoomQuestion] = {}
    for index, thing in enumerate(things):
        label = thing.words.label
        if not label or label in STUFF:
            continue
        meant, spared = _of_class(things, label)
        if thing.parent >= 0 and things[thing.parent].words.label not in STUFF:
            below = things[thing.parent].words.label
            on = frozenset(
                i for i in meant
                if things[i].parent >= 0 and is_a(things[things[i].parent].words.label, below)
            )  # fmt: skip
            text = f"the {label} on the {below}"
            found[text] = RoomQuestion("place", text, on, spared)
        for other, neighbour in enumerate(things):
            wanted = neighbour.words.label
            twins, _ = _of_class(things, wanted)
            if wanted in STUFF or len(twins) > 1 or len(meant) < 2 or other in meant:
                continue
            near = [i for i in meant if apart[i][other] <= NEAR_M]
            far = [i for i in meant if apart[i][other] >= APART_M]
            if near == [index] and len(far) == len(meant) - 1:
                for place in ("next to", "nearest to"):
                    text = f"the {label} {place} the {wanted}"
                    found[text] = RoomQuestion("place", text, frozenset({index}), spared)
    return list(found.values())


def boxes_of(things: Sequence[Thing]) -> UprightBoxes:
    """The true boxes."""
    ends = torch.tensor([[thing.low, thing.high] for thing in things]).reshape(-1, 2, 3)
    return UprightBoxes(ends[:, 0], ends[:, 1])


@dataclass(frozen=True)
class Outcome:
    """How one question was answered."""

    kind: Kind
    best: float
    """Probability of the likeliest object."""
    first: bool
    """Whether that is meant."""
    third: bool
    """Whether one of the three likeliest is meant."""
    shown: bool
    """Whether any object is meant at all: if none is, no reading of the question can be right."""


def outcome(
    question: RoomQuestion, probabilities: Float[Tensor, " object"], thing_of: Sequence[int]
) -> Outcome:
    """How probabilities of objects answer a question.

    Args:
        question: With its truth.
        probabilities: Of each object.
        thing_of: The thing that each object shows; -1 for none.
    """
    order = probabilities.argsort(descending=True, stable=True).tolist()
    kept = [row for row in order if thing_of[row] not in question.spared]
    right = [thing_of[row] in question.meant for row in kept]
    best = float(probabilities[kept[0]]) if kept else 0.0
    return Outcome(question.kind, best, right[:1] == [True], any(right[:3]), any(right))


@dataclass(frozen=True)
class QueryFigures:
    """The row of a table."""

    counts: Mapping[str, int]
    top_1: Mapping[str, float]
    """By kind, without absent ones."""
    top_3: Mapping[str, float]
    threshold: float
    """That was used, or that lets 90 % of the questions after what is there pass."""
    passed: float
    """Share of the questions after what is there whose likeliest object passes it."""
    false_alarms: float
    """Share of the questions after absent classes whose likeliest object passes it."""
    shown: float
    """Share of the questions after what is there of which some object is: the most that could be
    answered right."""
    alarms_of_classes: float
    """False alarms with the threshold that TRUE_SHARE of these class questions pass."""
    alarms_of_all: float
    """Likewise of all questions after what is there, which the other kinds make harder: synonyms
    are less alike, and places and colours multiply probabilities."""


def figures(outcomes: Sequence[Outcome], threshold: float | None = None) -> QueryFigures:
    """Shares of questions that were answered right.

    Args:
        outcomes: Of all questions of all rooms.
        threshold: Of the calibration; None takes that which 90 % of the class, synonym, colour and
            place questions pass.

    Raises:
        ValueError: There is no question.
    """
    of = {kind: [each for each in outcomes if each.kind == kind] for kind in KINDS}
    known = [each for each in outcomes if each.kind != "absent"]
    there = torch.tensor([each.best for each in known])
    limit = passing_threshold(there) if threshold is None else threshold
    asked = {kind: found for kind, found in of.items() if found}
    present = {kind: found for kind, found in asked.items() if kind != "absent"}
    absent = torch.tensor([each.best for each in of["absent"]])

    def alarms(least: float) -> float:
        return float((absent >= least).float().mean()) if len(absent) else 0.0

    def alarms_at_share(kept: Sequence[Outcome]) -> float:
        best = torch.tensor([each.best for each in kept])
        return alarms(passing_threshold(best)) if len(best) else 0.0

    return QueryFigures(
        {kind: len(found) for kind, found in asked.items()},
        {kind: sum(each.first for each in found) / len(found) for kind, found in present.items()},
        {kind: sum(each.third for each in found) / len(found) for kind, found in present.items()},
        limit,
        float((there >= limit).float().mean()) if len(there) else 0.0,
        alarms(limit),
        sum(each.shown for each in known) / len(known) if known else 0.0,
        alarms_at_share(of["class"]),
        alarms_at_share(known),
    )  # fmt: skip


def table(rows: Mapping[str, QueryFigures]) -> str:
    """Rows by their names as Markdown.

    Top 1 / top 3 by kind; what is found of absent and of present things with the threshold of the
    calibration; of absent ones with the thresholds that 90 % of the classes, and of all questions
    after what is there, pass; and of how many some object is there.
    """
    kinds = [kind for kind in KINDS if kind != "absent"]
    lines = [
        "| answers by | " + " | ".join(kinds) + " | absent, found | present, found "
        f"| absent at {TRUE_SHARE:.0%} of classes | at {TRUE_SHARE:.0%} of all | object is there |",
        "|" + "---|" * (len(kinds) + 6),
    ]
    for name, row in rows.items():
        cells = [
            f"{row.top_1[kind]:.3f} / {row.top_3[kind]:.3f}" if kind in row.top_1 else "-"
            for kind in kinds
        ]
        lines.append(
            f"| {name} | {' | '.join(cells)} | {row.false_alarms:.3f} | {row.passed:.3f} "
            f"| {row.alarms_of_classes:.3f} | {row.alarms_of_all:.3f} | {row.shown:.3f} |"
        )
    first = next(iter(rows.values()), None)
    counts = {} if first is None else first.counts
    lines.append("| questions | " + " | ".join(str(counts.get(kind, 0)) for kind in kinds)
                 + f" | {counts.get('absent', 0)} | | | | |")  # fmt: skip
    return "\n".join(lines)
