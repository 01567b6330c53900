"""Printed matter and fine textures: what is drawn, and that things carry one print each."""

import numpy as np
import pytest

from instok3d.rooms import fine_textures, prints
from instok3d.rooms.materials import Maker
from instok3d.rooms.objects.printed import printed_band, printed_box
from instok3d.rooms.textures import SIZE

GREY, DARK = np.full(3, 0.5), np.full(3, 0.2)


def drawn(name: str, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    more = {"boards": (), "carpet": (DARK,), "mosaic": (0.05,), "wallpaper": (DARK,),
            "woven": (DARK,)}  # fmt: skip
    return getattr(fine_textures, name)(rng, GREY, *more.get(name, ()))


@pytest.mark.parametrize(
    "name", ["boards", "brushed", "carpet", "mosaic", "plaster", "speckled", "wallpaper", "wood",
             "woven"],
)  # fmt: skip
def test_fine_textures_keep_their_colour_and_show_detail_at_a_distance(name):
    detail = []
    for seed in range(12):
        texture = drawn(name, seed).astype(float) / 255
        assert texture.shape == (SIZE, SIZE, 3)
        assert 0.15 < texture.mean() < 0.6
        # What is left after 4 x 4 texels are averaged, as a camera three metres away does.
        coarse = texture.mean(2).reshape(64, 4, 64, 4).mean((1, 3))
        detail.append(np.abs(np.diff(coarse, axis=1)).mean() / coarse.mean())
    assert max(detail) > (0.01 if name in ("plaster", "brushed") else 0.04)


@pytest.mark.parametrize("draw", [prints.packages, prints.papers, prints.spines, prints.poster])
def test_prints_differ_by_seed_and_hold_edges(draw):
    first, second = (draw(np.random.default_rng(seed)) for seed in (1, 2))
    assert (first != second).any()
    steps = [np.abs(np.diff(first.astype(int), axis=axis)).max(-1) for axis in (0, 1)]
    assert sum((step > 40).mean() for step in steps) > 0.04


def test_words_stay_within_their_picture():
    whole = np.zeros((40, 40, 3))
    prints.write_lines(np.random.default_rng(0), whole[10:30, 10:30], np.ones(3), 3)
    assert whole[10:30, 10:30].any()
    whole[10:30, 10:30] = 0
    assert not whole.any()


def test_a_picture_too_low_for_a_line_stays_empty():
    empty = np.zeros((2, 40, 3))
    prints.write_lines(np.random.default_rng(0), empty, np.ones(3), 3)
    assert not empty.any()


def test_a_thing_carries_one_cell_of_its_sheet():
    for seed in range(5):
        make = Maker(np.random.default_rng(seed))
        sheet = make.packages()
        for part in (
            printed_box(make, (1, 2, 3), (0.1, 0.2, 0.3), sheet),
            printed_band(make, 0.05, 0.1, 0.2, sheet),
        ):
            cells = part.uvs / sheet.tile_m * prints.CELLS
            low, high = cells.min(0), cells.max(0)
            np.testing.assert_array_equal(np.floor(low), np.floor(high))
            assert (high - low > 0.8).all()
