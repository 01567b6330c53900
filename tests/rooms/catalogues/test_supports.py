"""Where things may stand on a model."""

import numpy as np
import pytest

pytest.importorskip("embreex")

from instok3d.rooms.catalogues.supports import ROUGH_M, level_supports
from instok3d.rooms.materials import Maker
from instok3d.rooms.objects import REGISTRY
from instok3d.rooms.primitives import ball, box

MATERIAL = Maker(np.random.default_rng(0)).plain("wood", 0.5)


def test_a_table_carries_on_its_whole_top_but_a_margin():
    table = REGISTRY["coffee_table"](Maker(np.random.default_rng(1)))
    (support,) = level_supports(table.parts)
    width, depth, height = table.size
    assert support.z == pytest.approx(height, abs=1e-3)
    assert support.x1 - support.x0 == pytest.approx(width - 0.04, abs=0.05)
    assert support.y1 - support.y0 == pytest.approx(depth - 0.04, abs=0.05)


def test_under_a_roof_nothing_is_put():
    # A desk with a board over its right half: left of it the top is free, and so is the board.
    desk = box((0, 0, 0.35), (1.2, 0.6, 0.7), MATERIAL)
    board = box((0.3, 0, 1.0), (0.6, 0.6, 0.02), MATERIAL)
    found = sorted(level_supports((desk, board)), key=lambda support: support.z)
    assert [s.z for s in found] == pytest.approx([0.7, 1.01], abs=1e-3)
    assert found[0].x1 < 0.01
    assert found[1].x0 > -0.01


def test_round_narrow_low_and_high_things_carry_nothing():
    assert level_supports((ball((0, 0, 0.3), 0.3, MATERIAL),)) == ()
    assert level_supports((box((0, 0, 0.4), (1.0, 0.1, 0.8), MATERIAL),)) == ()
    assert level_supports((box((0, 0, 0.01), (1.0, 1.0, 0.02), MATERIAL),)) == ()
    assert level_supports((box((0, 0, 1.0), (1.0, 1.0, 2.0), MATERIAL),)) == ()


def test_cushions_that_are_roughly_level_carry_where_asked():
    sofa = REGISTRY["sofa"](Maker(np.random.default_rng(3)))
    (known,) = sofa.supports
    found = level_supports(sofa.parts, ROUGH_M)
    assert any(abs(support.z - known.z) < 0.06 for support in found)
