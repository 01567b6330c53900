"""Questions about rooms with known truth, and their figures, by hand."""

import pytest
import torch

from instok3d.data.words import ObjectWords
from instok3d.evaluation.queries import (
    ABSENT,
    BROADER,
    SYNONYMS,
    Outcome,
    RoomQuestion,
    Thing,
    figures,
    outcome,
    room_questions,
    table,
)
from instok3d.rooms.classes import CLASSES
from instok3d.semantics.query.grammar import singular, understand


def thing(label: str, color: str, x: float, *, size: float = 0.5, parent: int = -1) -> Thing:
    return Thing(ObjectWords(label, color), (x, 0.0, 0.0), (x + size, size, size), parent)


ROOM = [
    Thing(ObjectWords("wall", "white"), (0.0, 2.0, 0.0), (9.0, 2.1, 2.5), -1),
    thing("chair", "red", 0.0),
    thing("chair", "blue", 5.0, size=0.6),
    thing("armchair", "red", 7.0),
    thing("table", "brown", 5.7, size=1.0),
    thing("cup", "white", 5.8, size=0.1, parent=4),
]


def questions() -> dict[str, RoomQuestion]:
    return {each.text: each for each in room_questions(ROOM, 0)}


def test_classes_mean_narrower_ones_and_spare_broader_ones():
    asked = questions()
    assert asked["chair"].meant == {1, 2, 3}
    assert asked["chair"].spared == frozenset()
    assert asked["armchair"].meant == {3}
    assert asked["armchair"].spared == {1, 2}
    assert asked["seat"].kind == "synonym"
    assert asked["seat"].meant == {1, 2, 3}
    assert "wall" not in asked


def test_colours_sizes_and_places_have_their_truth():
    asked = questions()
    assert (asked["the red chair"].kind, asked["the red chair"].meant) == ("two colours", {1, 3})
    assert asked["the brown table"].kind == "colour + class"
    # Volumes .216 and .125 twice: 1.73 times the second.
    assert asked["the largest chair"].meant == {2}
    assert asked["the cup on the table"].meant == {5}
    # Of the chairs, 2 ends 0.1 before the table; 3 begins 0.3 behind it: not one alone.
    assert "the chair next to the table" not in asked


def test_one_thing_next_to_another_is_asked_for_where_its_twins_are_far():
    room = [thing("chair", "red", 0.0), thing("chair", "red", 5.0), thing("bed", "blue", 5.7)]
    asked = {each.text: each for each in room_questions(room, 0)}
    assert asked["the chair next to the bed"].meant == {1}
    assert asked["the chair nearest to the bed"].meant == {1}
    assert "the bed next to the chair" not in asked


def test_absent_classes_are_of_no_family_that_is_there():
    absent = {each.text for each in room_questions(ROOM, 0) if each.kind == "absent"}
    assert len(absent) == ABSENT
    assert not absent & {"chair", "armchair", "table", "side table", "coffee table", "cup", "wall"}
    again = {each.text for each in room_questions(ROOM, 0) if each.kind == "absent"}
    assert absent == again
    assert len(room_questions([], 0)) == ABSENT


def test_every_question_is_understood():
    for each in room_questions(ROOM, 0):
        understand(each.text)
    for words in SYNONYMS.values():
        for word in words:
            assert understand(word).thing.noun in (word, singular(word))


def test_synonyms_are_of_classes_and_no_class_themselves():
    assert set(SYNONYMS) <= set(CLASSES)
    words = [word for each in SYNONYMS.values() for word in each]
    assert len(set(words)) == len(words)
    assert not set(words) & set(CLASSES)
    assert set(BROADER) | set(BROADER.values()) <= set(CLASSES)


def test_an_outcome_by_hand():
    question = RoomQuestion("class", "chair", frozenset({1}), frozenset({2}))
    # Likeliest first: of thing 2, spared; of none; of thing 1.
    found = outcome(question, torch.tensor([0.5, 0.9, 0.7]), (1, 2, -1))
    assert (found.kind, found.first, found.third, found.shown) == ("class", False, True, True)
    assert found.best == pytest.approx(0.7)
    assert outcome(question, torch.zeros(0), ()) == Outcome("class", 0.0, False, False, False)
    # The fourth of the likeliest is there, but not among the first three.
    late = outcome(question, torch.tensor([0.9, 0.8, 0.7, 0.6]), (3, 4, 5, 1))
    assert (late.first, late.third, late.shown) == (False, False, True)


def test_figures_by_hand():
    outcomes = [
        Outcome("class", 0.9, True, True, True),
        Outcome("class", 0.4, False, True, True),
        Outcome("synonym", 0.2, False, False, False),
        Outcome("absent", 0.5, False, False, False),
        Outcome("absent", 0.3, False, False, False),
        Outcome("absent", 0.1, False, False, False),
    ]
    found = figures(outcomes, 0.4)
    assert found.top_1 == {"class": 0.5, "synonym": 0.0}
    assert found.top_3 == {"class": 1.0, "synonym": 0.0}
    assert found.false_alarms == pytest.approx(1 / 3)
    # Both classes pass 0.4; all three questions pass 0.2.
    assert found.alarms_of_classes == pytest.approx(1 / 3)
    assert found.alarms_of_all == pytest.approx(2 / 3)
    assert found.shown == pytest.approx(2 / 3)
    assert found.passed == pytest.approx(2 / 3)
    # 90 % of three questions are all three.
    assert figures(outcomes).threshold == pytest.approx(0.2)
    text = table({"words": found})
    assert "| words | 0.500 / 1.000 | 0.000 / 0.000 | - |" in text
    assert "| 0.333 | 0.667 | 0.333 | 0.667 | 0.667 |" in text
    assert text.splitlines()[-1].startswith("| questions | 2 | 1 | 0 |")
    with pytest.raises(ValueError, match="no question"):
        figures([])
