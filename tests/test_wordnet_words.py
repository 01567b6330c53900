"""Words that runs/text_table.py takes from a database in WordNet's form."""

import runpy
from pathlib import Path

import pytest

SCRIPT = runpy.run_path(str(Path(__file__).parents[1] / "runs" / "wordnet_words.py"))
NOUNS = """\
  1 the licence
00000100 06 n 01 seat 0 002 ~ 00000200 n 0000 ~ 00000300 n 0000 | to sit on
00000200 06 n 02 chair 0 easy_chair 0 002 @ 00000100 n 0000 ~ 00000400 n 0000 | with a back
00000300 06 n 01 Barcelona_Chair 0 001 @ 00000100 n 0000 | by name
00000400 06 n 01 very_old_wing_chair 0 001 @ 00000200 n 0000 | four words
00000500 15 n 01 Berlin 0 000 | a town
00000600 15 n 01 chair 0 000 | a post
"""
SENSES = """\
  1 the licence
chair n 2 2 @ ~ 2 1 00000600 00000200
easy_chair n 1 1 @ 1 0 00000200
seat n 1 1 ~ 1 1 00000100
"""


@pytest.fixture
def database(tmp_path: Path) -> Path:
    (tmp_path / "data.noun").write_text(NOUNS)
    (tmp_path / "index.noun").write_text(SENSES)
    for kind in ("verb", "adj", "adv"):
        (tmp_path / f"data.{kind}").write_text("")
    (tmp_path / "data.adj").write_text("00000700 00 a 01 galore(ip) 0 000 | many\n")
    for kind in ("noun", "verb", "adj", "adv"):
        (tmp_path / f"{kind}.exc").write_text("oxen ox\n" if kind == "noun" else "")
    return tmp_path


def test_household_names_are_all_kinds_of_the_first_meaning_of_a_thing(database: Path):
    names = SCRIPT["household_names"]
    for roots, found in [
        (("seat",), ["barcelona chair", "chair", "easy chair", "seat"]),
        (("chair",), ["chair", "easy chair"]),  # its first meaning is a post, no thing
        ((), []),
    ]:
        names.__globals__["ROOTS"] = roots
        assert names(database) == found


def test_common_words_may_be_inflected_and_are_no_proper_names_alone(database: Path):
    words = SCRIPT["CommonWords"](database)
    known = ("chair", "chairs", "seat", "seated", "seating", "seatting", "oxen", "galore")
    unknown = ("berlin", "barcelona", "cha", "")
    assert [word in words for word in known] == [True] * len(known)
    assert [word in words for word in unknown] == [False] * len(unknown)
