import numpy as np
import pytest

from instok3d.rooms.seen_colors import lab, seen_colors

COLORS = {
    "white": (245, 245, 245), "grey": (128, 128, 128), "black": (5, 5, 5), "red": (200, 20, 20),
    "orange": (235, 130, 30), "yellow": (240, 220, 40), "green": (40, 150, 40),
    "turquoise": (40, 170, 170), "blue": (30, 80, 200), "purple": (110, 40, 160),
    "pink": (240, 140, 180), "brown": (110, 65, 30), "beige": (220, 205, 170),
}  # fmt: skip


def picture(*strips: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Strips of 20 pixels with the ids 1, 2, ..., below a white one with the id 0."""
    images = np.repeat(np.array([(255, 255, 255), *strips], np.uint8)[None, :, None], 20, axis=2)
    ids = np.repeat(np.arange(len(strips) + 1)[None, :, None], 20, axis=2)
    return images, ids


def test_plain_colours_have_their_names():
    names = seen_colors(*picture(*COLORS.values()))
    assert names == dict(enumerate(COLORS, 1))


def test_most_pixels_give_the_name_over_all_pictures():
    red, blue = picture((200, 20, 20)), picture((30, 80, 200))
    images = np.concatenate([red[0], blue[0], blue[0]])
    assert seen_colors(images, np.concatenate([red[1]] * 3)) == {1: "blue"}


@pytest.mark.parametrize(("light", "name"), [(1.0, "white"), (0.65, "white"), (0.2, "grey")])
def test_what_is_white_in_dim_light_is_white_and_in_the_dark_it_is_not(light: float, name: str):
    images, ids = picture((250, 250, 250))
    assert seen_colors((images * light).astype(np.uint8), ids) == {1: name}


def test_pixels_without_an_instance_and_no_pixels_have_no_names():
    images, ids = picture((200, 20, 20))
    assert seen_colors(images, ids * 0) == seen_colors(images, ids * 0 - 1) == {}
    assert seen_colors(images[:0], ids[:0]) == {}


def test_lab_of_known_colours():
    """By a calculator of others: white, and the red primary of sRGB."""
    found = lab(np.array([[1.0, 1, 1], [1, 0, 0]]))
    np.testing.assert_allclose(found, [[100, 0, 0], [53.24, 80.09, 67.20]], atol=0.02)
