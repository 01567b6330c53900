"""Which objects are meant: in a space whose words are axes, worked out by hand."""

import math
from collections.abc import Sequence

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from instok3d.semantics.query.calibration import Calibration
from instok3d.semantics.query.grammar import understand
from instok3d.semantics.query.ranking import (
    COLOR_NAMES,
    MATERIAL_NAMES,
    Candidates,
    Ranker,
    class_probabilities,
    first_of,
    similarity,
    vocabulary_of,
)
from instok3d.semantics.query.relations import UprightBoxes

CLASSES = ("wall", "chair", "table", "window")
WORDS = (*CLASSES, *COLOR_NAMES, *MATERIAL_NAMES, "box")


def embed(texts: Sequence[str]) -> Tensor:
    """The mean of the axes of the words that there are."""
    vectors = torch.zeros(len(texts), len(WORDS))
    for row, text in enumerate(texts):
        known = [WORDS.index(word) for word in text.split() if word in WORDS]
        if not known:
            raise ValueError(f"no word of {text!r} is known")
        vectors[row, known] = 1.0
    return functional.normalize(vectors, dim=1)


VOCABULARY = vocabulary_of(CLASSES, ("wall",), embed)
CALIBRATION = Calibration(
    class_scale=20.0,
    color_scale=20.0,
    score_weight=20.0,
    evidence_weight=0.0,
    bias=-8.0,
    threshold=0.5,
)


def thing(name: str, color: str) -> Tensor:
    return functional.normalize(embed([name])[0] + embed([color])[0] / 2, dim=0)


def scene(named: Sequence[str | None] = (None,) * 6) -> Candidates:
    """Two chairs at x = 0 and 5, a small and a large table, a window at x = 5.6, and a wall."""
    spans = [(0.0, 0.5, 0.9), (5.0, 0.5, 0.9), (2.0, 0.8, 0.5), (8.0, 1.5, 0.8), (5.6, 0.5, 2.0),
             (-2.0, 13.0, 2.5)]  # fmt: skip
    low = torch.tensor([[x, 0.0, 0.0] for x, _, _ in spans])
    low[5, 1] = 3.0
    high = low + torch.tensor([[width, width, height] for _, width, height in spans])
    high[5, 1] = 3.1
    things = (("chair", "red"), ("chair", "blue"), ("table", "brown"), ("table", "white"),
              ("window", "white"), ("wall", "white"))  # fmt: skip
    vectors = [thing(*each) for each in things]
    return Candidates(torch.stack(vectors), UprightBoxes(low, high), tuple(named))


def ranked(text: str, candidates: Candidates | None = None) -> Tensor:
    ranker = Ranker(candidates or scene(), embed, VOCABULARY, CALIBRATION)
    return ranker.question(understand(text))


def meant(text: str, candidates: Candidates | None = None) -> list[int]:
    return (ranked(text, candidates) >= CALIBRATION.threshold).nonzero()[:, 0].tolist()


def test_classes_by_hand():
    # Cosines 1 and 0 of two classes at a scale of ln 3: 3 to 1.
    two = vocabulary_of(("chair", "table"), (), embed)
    shares = class_probabilities(embed(["chair"]), two, torch.tensor(3.0).log().item())
    assert shares[0].tolist() == pytest.approx([0.75, 0.25])


def test_a_similarity_by_hand():
    # Four classes, at scales of ln 3: 1/2 for the own one and 1/6 for each other one. That both
    # are of one class: 1/4 + 3 / 36 = 1/3.
    scales = Calibration(class_scale=math.log(3), text_scale=math.log(3))
    found = similarity(embed(["chair"]), embed(["chair"])[0], VOCABULARY, scales)
    assert float(found.scores[0]) == pytest.approx(1)
    assert float(found.evidence[0]) == pytest.approx(-math.log(3))
    other = similarity(embed(["table"]), embed(["chair"])[0], VOCABULARY, scales)
    # 2 x 1/2 x 1/6 + 2 x 1/36 = 2/9.
    assert float(other.scores[0]) == pytest.approx(0)
    assert float(other.evidence[0]) == pytest.approx(math.log(2 / 9))


@pytest.mark.parametrize(
    ("text", "objects"),
    [
        ("chair", [0, 1]),
        ("all tables", [2, 3]),
        ("the red chair", [0]),
        ("the blue chair", [1]),
        ("the green chair", []),
        ("the white table", [3]),
        ("red table", []),
        ("box", []),
        ("largest table", [3]),
        ("smallest table", [2]),
        ("chair next to the window", [1]),
        ("chair nearest to the window", [1]),
        ("chair farthest from the window", [0]),
        ("chair on the table", []),
        ("window between the chair and the table", [4]),
        ("largest thing", [3]),  # the wall is none
        ("something white", [3, 4]),
    ],
)
def test_what_is_meant_passes_the_threshold_and_nothing_else(text: str, objects: list[int]):
    assert meant(text) == objects


def test_a_name_that_a_person_gave_wins():
    named = scene((None, "Throne", None, None, None, None))
    assert meant("throne", named) == [1]
    assert float(ranked("throne", named)[1]) == 1
    with pytest.raises(ValueError, match="no word of 'throne'"):
        ranked("throne")


def test_seen_colours_decide_where_they_are_known():
    seen = torch.full((6, len(COLOR_NAMES)), 1e-3)
    seen[0, COLOR_NAMES.index("green")] = 1.0
    bare = scene()
    painted = Candidates(bare.vectors, bare.boxes, bare.named, seen)
    assert meant("green chair", painted) == [0]
    # Of the other chair no colour is seen more than others: one against the next is 1/2.
    red = ranked("red chair", painted)
    assert float(red[1]) == pytest.approx(float(ranked("chair")[1]) / 2)
    assert float(red[0]) < 0.01


def test_the_first_in_order_is_meant_if_no_better_one_is():
    # By rising key: 0.5 of the second, then 0.5 x 0.8 of the first, then 0.5 x 0.2 x 0.9.
    first = first_of(torch.tensor([0.8, 0.5, 0.9]), torch.tensor([2.0, 3.0, 1.0]))
    assert first.tolist() == pytest.approx([0.4, 0.5, 0.09])


@pytest.mark.parametrize(
    "text", ["chair", "largest table", "red chair next to the window", "box nearest the window",
             "chair between the table and the window", "all things"]
)  # fmt: skip
def test_no_object_is_an_answer_too(text: str):
    empty = Candidates(torch.zeros(0, len(WORDS)), UprightBoxes(torch.zeros(0, 3),
                                                                torch.zeros(0, 3)), ())  # fmt: skip
    assert ranked(text, empty).shape == (0,)


def test_a_picture_is_ranked_by_the_same_calibration():
    ranker = Ranker(scene(), embed, VOCABULARY, CALIBRATION)
    torch.testing.assert_close(ranker.picture(embed(["chair"])[0]), ranked("chair"))
