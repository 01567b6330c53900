import pytest

from instok3d.data.words import ObjectWords
from instok3d.rooms.words import stored_words, with_seen_colors

SOFA = {"id": 3, "class": "sofa", "color": "red", "material": "fabric", "stuff": False}


def test_what_the_generator_said_becomes_words():
    wall = {"id": 1, "class": "wall", "color": "white", "material": "unknown"}
    assert stored_words({"seed": 0, "instances": [SOFA, wall]}) == {
        3: ObjectWords("sofa", "red", "fabric"),
        1: ObjectWords("wall", "white", ""),
    }


def test_rooms_of_which_less_is_known_have_fewer_words():
    assert stored_words({"seed": 0}) == {}
    assert stored_words({"seed": 0, "instances": [{"stuff": False}]}) == {}
    assert stored_words({"seed": 0, "instances": [{"id": 1, "class": "bed"}]}) == {
        1: ObjectWords("bed")
    }


@pytest.mark.parametrize("change", [{"id": "3"}, {"id": 0}, {"class": 5}, {"color": None}])
def test_words_of_another_kind_are_refused(change):
    with pytest.raises((TypeError, ValueError)):
        stored_words({"seed": 0, "instances": [SOFA | change]})


def test_an_id_that_stands_twice_is_refused():
    with pytest.raises(ValueError, match="two instances of seed 7 have the id 3"):
        stored_words({"seed": 7, "instances": [SOFA, SOFA]})


def test_seen_colours_take_the_place_of_stored_ones_but_not_behind_glass():
    words = {1: ObjectWords("sofa", "red"), 2: ObjectWords("window", "white"),
             3: ObjectWords("bed", "blue")}  # fmt: skip
    assert with_seen_colors(words, {1: "pink", 2: "green", 7: "black"}) == {
        1: ObjectWords("sofa", "pink"),
        2: ObjectWords("window", "white"),
        3: ObjectWords("bed", "blue"),
    }
    assert with_seen_colors({}, {1: "red"}) == {}
