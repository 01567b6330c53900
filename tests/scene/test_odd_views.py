import pytest
import torch

from instok3d.backbones.nano.common_points import CommonPoints
from instok3d.scene.odd_views import (
    CONFIRMED_SHARE,
    MATCHED_SHARE,
    choose_confirmed_views,
    choose_matching_views,
)

NAMES = ["a.jpg", "b.jpg", "c.jpg", "d.jpg", "e.jpg"]


def pair(a: int, b: int, share: float) -> CommonPoints:
    return CommonPoints(a, b, torch.zeros(0, 2), torch.zeros(0, 2), share)


def choose(pairs: list[CommonPoints], count: int, blank: tuple[int, ...] = (), posed: bool = False):
    contrast = torch.tensor([0.0 if view in blank else 0.5 for view in range(count)])
    return choose_matching_views(pairs, contrast, NAMES[:count], posed=posed)


def test_views_that_are_linked_by_others_all_stay_without_a_note():
    choice = choose([pair(0, 1, 0.3), pair(1, 2, MATCHED_SHARE), pair(0, 2, 0.0)], 3)
    assert (choice.kept, choice.notes) == ([0, 1, 2], [])


@pytest.mark.parametrize("odd", [0, 1, 3])
def test_a_view_that_matches_no_other_is_left_out_and_named(odd: int):
    others = [view for view in range(4) if view != odd]
    pairs = [pair(others[0], others[1], 0.2), pair(others[1], others[2], 0.2)]
    choice = choose([*pairs, pair(min(odd, 1), max(odd, 1) + 1, 0.005)], 4)
    assert choice.kept == others
    assert choice.notes == [f"left out, as they match none of the other photos: {NAMES[odd]}"]


def test_of_two_rooms_the_one_with_more_photos_stays():
    choice = choose([pair(0, 1, 0.3), pair(2, 3, 0.2), pair(3, 4, 0.2)], 5)
    assert choice.kept == [2, 3, 4]
    assert "a.jpg, b.jpg" in choice.notes[0]
    even = choose([pair(0, 1, 0.3), pair(2, 3, 0.3)], 4)
    assert even.kept == [0, 1]


def test_two_photos_that_do_not_match_stay_with_a_note():
    choice = choose([pair(0, 1, 0.004)], 2)
    assert choice.kept == [0, 1]
    assert "no two of these photos match: a.jpg, b.jpg" in choice.notes[0]


def test_a_covered_photo_is_left_out_even_of_two_and_if_it_is_the_first():
    choice = choose([pair(0, 1, 0.0)], 2, blank=(0,))
    assert choice.kept == [1]
    assert choice.notes == ["left out, as they match none of the other photos: a.jpg"]


def test_photos_that_all_show_nothing_stay_with_a_note():
    for count, pairs in ((1, []), (2, [pair(0, 1, 0.0)])):
        choice = choose(pairs, count, blank=(0, 1))
        assert choice.kept == list(range(count))
        (note,) = choice.notes
        assert note.startswith("nothing can be made out in any photo")


def test_given_cameras_keep_a_view_that_shows_another_side_of_the_room():
    pairs = [pair(0, 1, 0.2), pair(1, 2, 0.0), pair(1, 3, 0.0)]
    choice = choose(pairs, 4, blank=(3,), posed=True)
    assert choice.kept == [0, 1, 2]
    left, alone = choice.notes
    assert left.endswith(": d.jpg")
    assert alone.startswith("these photos match none of the others: c.jpg; their cameras are used")


def test_one_photo_has_nothing_to_match():
    choice = choose([], 1)
    assert (choice.kept, choice.notes) == ([0], [])


def confirm(pairs: list[CommonPoints], fits: list[float], count: int):
    return choose_confirmed_views(pairs, fits, NAMES[:count])


def test_cameras_that_most_matches_fit_are_confirmed():
    # c fits b alone; the pair a, c contradicts the cameras.
    pairs = [pair(0, 1, 0.2), pair(1, 2, 0.1), pair(0, 2, 0.3)]
    choice = confirm(pairs, [0.9, CONFIRMED_SHARE / 0.1, 0.0], 3)
    assert (choice.kept, choice.notes) == ([0, 1, 2], [])


def test_a_view_whose_matches_fit_no_camera_is_left_out_and_named():
    # Many matches with three views, as of things that repeat: .3 x .03 = .009 is below .012.
    pairs = [pair(0, 1, 0.2), pair(1, 3, 0.1), *(pair(view, 2, 0.3) for view in (0, 1, 3))]
    choice = confirm(pairs, [0.9, 0.9, 0.03, 0.03, 0.0], 4)
    assert choice.kept == [0, 1, 3]
    (note,) = choice.notes
    assert note.startswith("left out, as no cameras fit their matches with the other photos")
    assert note.endswith(": c.jpg")


def test_a_view_that_few_matches_confirm_stays_with_a_note():
    # .04 x .5 = .02 lies between .012 and .035.
    choice = confirm([pair(0, 1, 0.2), pair(1, 2, 0.04)], [0.9, 0.5], 3)
    assert choice.kept == [0, 1, 2]
    (note,) = choice.notes
    assert note.startswith("the cameras of these photos may be wrong, as few matches fit them: c")
    choice = confirm([pair(0, 1, 0.04)], [0.5], 2)
    assert "few matches fit them: a.jpg, b.jpg" in choice.notes[0]


def test_if_no_two_cameras_fit_all_views_stay_with_a_note():
    choice = confirm([pair(0, 1, 0.02), pair(1, 2, 0.3)], [0.5, 0.0], 3)
    assert choice.kept == [0, 1, 2]
    (note,) = choice.notes
    assert note.startswith("no cameras fit the matches of these photos: a.jpg, b.jpg, c.jpg")


def test_one_photo_has_no_camera_to_confirm():
    choice = confirm([], [], 1)
    assert (choice.kept, choice.notes) == ([0], [])


def test_photos_of_which_no_two_match_are_noted_once():
    pairs = [pair(0, 1, MATCHED_SHARE / 2), pair(1, 2, 0.0)]
    assert "a guess" in choose(pairs, 3).notes[0]
    assert confirm(pairs, [1.0, 0.0], 3).notes == []
