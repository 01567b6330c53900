import pytest

from instok3d.semantics.wordpiece import basic_words, pieces

WORDS = ["[UNK]", "arm", "##chair", "##chairs", "chair", "red", "-", "##s", "椅"]
VOCABULARY = {piece: number for number, piece in enumerate(WORDS)}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Red Chair", ["red", "chair"]),
        ("  a\tb\n", ["a", "b"]),
        ("café", ["cafe"]),
        ("o'clock, no-one!", ["o", "'", "clock", ",", "no", "-", "one", "!"]),
        ("a^b $5", ["a", "^", "b", "$", "5"]),
        ("赤い椅子", ["赤", "い", "椅", "子"]),
        ("zero\u200bwidth\x00", ["zerowidth"]),
        ("", []),
    ],
)
def test_words_as_berts_uncased_models_have_them(text: str, words: list[str]):
    assert basic_words(text) == words


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("armchairs", ["arm", "##chairs"]),
        ("red arm-chair", ["red", "arm", "-", "chair"]),
        ("armchairx", ["[UNK]"]),
        ("椅", ["椅"]),
        ("a" * 101, ["[UNK]"]),
        ("", []),
    ],
)
def test_a_word_is_cut_into_the_longest_known_pieces(text: str, found: list[str]):
    assert [WORDS[each] for each in pieces(text, VOCABULARY)] == found


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("red chest of drawers", ["red", "chest of drawers"]),
        ("Chest  of\tdrawers red", ["chest of drawers", "red"]),
        ("chest of", ["chest", "of"]),
        ("coffee table", ["coffee table"]),
        ("coffee-table", ["coffee", "-", "table"]),
        ("coffee tables", ["coffee", "table", "##s"]),
        ("chest of coffee table", ["chest", "of", "coffee table"]),
    ],
)
def test_the_longest_known_name_goes_before_its_words(text: str, found: list[str]):
    names = ["[UNK]", "red", "chest", "of", "drawers", "chest of drawers", "coffee", "table",
             "coffee table", "of drawers", "##s", "-"]  # fmt: skip
    vocabulary = {name: number for number, name in enumerate(names)}
    assert [names[each] for each in pieces(text, vocabulary)] == found
