"""What questions are understood as, and how the others are refused."""

import random

import pytest

from instok3d.semantics.query.grammar import (
    MAX_PLACES,
    MAX_TEXT,
    Description,
    NotUnderstoodError,
    Relation,
    is_plural,
    singular,
    understand,
)
from instok3d.semantics.query.vocabulary import COLORS, ORDERS, PLACES, REFUSED

WINDOW, DESK = Description("window"), Description("desk")

UNDERSTOOD = {
    "chair": Description("chair"),
    "Show me the CHAIR, please!": Description("chair"),
    "where is the trash can in the room?": Description("trash can"),
    "the red chair": Description("chair", ("red",)),
    "the chair that is red": Description("chair", ("red",)),
    "a dark gray wooden chair": Description("chair", ("grey",), ("wood",)),
    "the black and white chair": Description("chair", ("black", "white")),
    "glass table": Description("table", (), ("glass",)),
    "glass": Description("glass"),
    "something red": Description("", ("red",)),
    "largest table": Description("table", order="largest"),
    "the small round table": Description("round table", order="smallest"),
    "the largest object": Description("", order="largest"),
    "chest of drawers": Description("chest of drawers"),
    "the front door": Description("front door"),
    "something to sit on": Description("something to sit on"),
    "chair next to the window": Description("chair", place=Relation("next to", (WINDOW,))),
    "the lamp that is standing on the desk": Description("lamp", place=Relation("on", (DESK,))),
    "thing on top of the desk": Description("", place=Relation("on", (DESK,))),
    "the chair nearest to the window": Description("chair", place=Relation("nearest", (WINDOW,))),
    "the chair nearest the window": Description("chair", place=Relation("nearest", (WINDOW,))),
    "the closest chair to the window": Description("chair", place=Relation("nearest", (WINDOW,))),
    "the chair farthest from the desk": Description("chair", place=Relation("farthest", (DESK,))),
    "rug between the desk and the window": Description(
        "rug", place=Relation("between", (DESK, WINDOW))
    ),
    "the cup on the largest table": Description(
        "cup", place=Relation("on", (Description("table", order="largest"),))
    ),
    "lamp on the desk next to the window": Description(
        "lamp",
        place=Relation("on", (Description("desk", place=Relation("next to", (WINDOW,))),)),
    ),
}


@pytest.mark.parametrize("text", UNDERSTOOD)
def test_a_question_says_what_is_meant(text: str):
    asked = understand(text)
    assert asked.thing == UNDERSTOOD[text]
    assert (asked.several, asked.count) == (False, None)


@pytest.mark.parametrize(
    ("text", "noun", "count"),
    [
        ("all chairs", "chair", None),
        ("every chair", "chair", None),
        ("chairs", "chair", None),
        ("all of the shelves", "shelf", None),
        ("the two boxes", "box", 2),
        ("3 chairs", "chair", 3),
        ("everything on the desk", "", None),
        ("books", "books", 0),  # one object is called so: not several
        ("one chair", "chair", 0),
    ],
)
def test_several_are_asked_for_by_all_by_a_number_or_by_a_plural(
    text: str, noun: str, count: int | None
):
    asked = understand(text)
    assert asked.several == (count != 0)
    assert asked.count == (count or None)
    if text != "one chair":
        assert asked.thing.noun == noun


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "the question is empty"),
        ("  \n", "the question is empty"),
        ("?!", "there is no word in"),
        ("the", "no thing is named in 'the'"),
        ("chair on the", "no thing is named"),
        ("x" * (MAX_TEXT + 1), f"has {MAX_TEXT + 1} characters, at most {MAX_TEXT}"),
        ("chair without arms", "what something is not: leave out 'without'"),
        ("a chair but not the red one", "what something is not"),
        ("chair or sofa", "one thing at a time"),
        ("table and chair", "one thing at a time"),
        ("chair left of the table", "'left' depends on where one looks from"),
        ("the chair to the right of the table", "'right' depends on where one looks from"),
        ("lamp in front of the sofa", "'front' depends on where one looks from"),
        ("the box behind the sofa", "'behind' depends on where one looks from"),
        ("table larger than the desk", "not by 'than'"),
        ("how many chairs are there", "it does not count"),
        ("the second largest table", "'second' is not understood"),
        ("chair in the corner", "'corner' is no place that boxes tell"),
        ("nearest chair", "'nearest' needs a thing to measure from"),
        ("rug between the beds", "'between' takes two things"),
        ("the largest smallest table", "two orders"),
        ("all the largest chairs", "'largest' is one of several"),
        ("cup on a b on c on d on e", f"at most {MAX_PLACES} places"),
        ("lamp on the thing", "'on' needs another thing"),
        ("chair with arms", "'with' is not understood"),
    ],
)
def test_what_is_not_understood_is_refused_in_one_sentence(text: str, reason: str):
    with pytest.raises(NotUnderstoodError) as caught:
        understand(text)
    said = str(caught.value)
    assert reason in said
    assert len(said) < 250
    assert "\n" not in said


def test_what_was_understood_is_said():
    words = understand("all red wooden chairs on the rug").words()
    assert words == "all objects like 'chair', colour red, of wood, on (like 'rug')"
    assert understand("two cups").words() == "2 objects like 'cup'"
    assert understand("largest thing").words() == "one object, the largest of them"


def test_plurals_become_one():
    pairs = {"chairs": "chair", "boxes": "box", "shelves": "shelf", "bookshelves": "bookshelf",
             "benches": "bench", "glasses": "glass", "batteries": "battery"}  # fmt: skip
    assert {word: singular(word) for word in pairs} == pairs
    assert [is_plural(word) for word in ("chairs", "books", "glass", "bus", "tv", "gas")] == [
        True, False, False, False, False, False,
    ]  # fmt: skip


def test_any_words_are_understood_or_refused():
    rng = random.Random(0)
    known = [*COLORS, *ORDERS, *REFUSED, *(word for each in PLACES for word in each), "chair",
             "the", "all", "two", "of", "and", "to", "from", "nearest", "something", "thing", "is",
             "椅子", "ß", "'", "-", "10", "\u202e", "\0"]  # fmt: skip
    said = []
    for _ in range(3000):
        try:
            understand(" ".join(rng.choices(known, k=rng.randrange(1, 9)))).words()
        except NotUnderstoodError as error:
            said.append(str(error))
    assert 100 < len(said) < 2900
    assert all(0 < len(each) < 400 for each in said)
