"""What tools take, and the schemas that say so."""

from typing import Any

import jsonschema
import pytest

from instok3d.service.parameters import (
    ArgumentError,
    Parameter,
    arguments_schema,
    check_arguments,
)

TEXT = Parameter("text", "string", "Words.", required=True, most=5)
COUNT = Parameter("count", "integer", "How many.", 3, least=1, most=10)
RATIO = Parameter("ratio", "number", "How much.", least=0)
EACH = Parameter("each", "boolean", "Whether.", False)
KIND = Parameter("kind", "string", "Which.", "a", choices=("a", "b"))
ALL = (TEXT, COUNT, RATIO, EACH, KIND)


def test_defaults_are_filled_in_and_texts_of_addresses_read():
    given = {"text": "x", "count": "7", "ratio": "0.5", "each": "true", "kind": "b"}
    assert check_arguments(ALL, given) == {
        "text": "x", "count": 7, "ratio": 0.5, "each": True, "kind": "b",
    }  # fmt: skip
    assert check_arguments(ALL, {"text": "x", "ratio": None}) == {
        "text": "x", "count": 3, "ratio": None, "each": False, "kind": "a",
    }  # fmt: skip
    assert check_arguments((), {}) == {}


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "text is missing: Words."),
        ({"text": ""}, "text must be a text of 1 to 5 characters, got ''"),
        ({"text": "abcdef"}, "text must be a text of 1 to 5 characters"),
        ({"text": 3}, "text must be a text"),
        ({"text": "x", "other": 1}, "no parameter 'other'; there are: text, count"),
        ({"text": "x", "count": 0}, "count must be a whole number from 1 up to 10, got '0'"),
        ({"text": "x", "count": 1.5}, "count must be a whole number"),
        ({"text": "x", "count": True}, "count must be a whole number"),
        ({"text": "x", "count": "1e400"}, "count must be a whole number"),
        ({"text": "x", "ratio": "nan"}, "ratio must be a number from 0, got 'nan'"),
        ({"text": "x", "ratio": [1]}, "ratio must be a number"),
        ({"text": "x", "each": "yes"}, "each must be true or false"),
        ({"text": "x", "kind": "c"}, "kind must be one of a, b, got 'c'"),
    ],
)
def test_what_is_wrong_is_one_sentence(given: dict[str, Any], words: str):
    with pytest.raises(ArgumentError, match=words):
        check_arguments(ALL, given)


@pytest.mark.parametrize(
    "given",
    [
        {"text": "x"}, {"text": "x", "count": 10, "ratio": 2.5, "each": True, "kind": "b"},
        {}, {"text": ""}, {"text": "abcdef"}, {"text": "x", "count": 11}, {"text": "x", "y": 1},
        {"text": "x", "kind": "c"}, {"text": "x", "ratio": -1}, {"text": "x", "each": 1},
    ],
)  # fmt: skip
def test_the_schema_takes_what_is_taken_and_nothing_else(given: dict[str, Any]):
    sound = jsonschema.Draft202012Validator(arguments_schema(ALL)).is_valid(given)
    try:
        check_arguments(ALL, given)
    except ArgumentError:
        assert not sound
    else:
        assert sound
