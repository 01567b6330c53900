import math

import pytest
import torch

from instok3d.photos.distortion import Distortion

# A corner of 200 x 200 pixels with f = 100 is at (1, 1) on the plane z = 1: r^2 = 2.
INTRINSICS = torch.tensor([[100.0, 0, 100], [0, 100, 100], [0, 0, 1]], dtype=torch.float64)
CORNER = torch.tensor([[1.0, 1.0]], dtype=torch.float64)


def test_every_term_bends_by_hand():
    # k1 r2 = 0.2, k2 r4 = 0.04, k3 r6 = 0.008: 1.248 of itself. p1: x += 2 * 0.001, y += 0.001 * 4;
    # p2: x += 0.002 * 4, y += 2 * 0.002.
    bent = Distortion(0.1, 0.01, 0.001, 0.002, 0.001).bend(CORNER)
    assert bent[0].tolist() == pytest.approx([1.248 + 0.002 + 0.008, 1.248 + 0.004 + 0.004])
    assert torch.equal(Distortion().bend(CORNER), CORNER)


@pytest.mark.parametrize("term", ["k1", "k2", "k3", "p1", "p2"])
def test_no_term_is_read_past(term):
    assert Distortion(**{term: 0.1}).largest_shift(INTRINSICS, 200, 200) > 0.05
    assert Distortion(**{term: 0.1})
    assert not Distortion()


def test_the_shift_of_a_corner_by_hand():
    # k3 = -3 moves the corner by 3 * 2^3 = 24 times its distance from the middle, which is half
    # of the diagonal.
    assert Distortion(k3=-3.0).largest_shift(INTRINSICS, 200, 200) == pytest.approx(12.0)


def test_terms_that_cancel_at_the_corners_are_seen_between_them():
    # At r2 = 2: 0.4 * 2 - 0.2 * 4 = 0; at r2 = 1, in the middle of a side, 0.2 of 100 pixels.
    shift = Distortion(0.4, -0.2).largest_shift(INTRINSICS, 200, 200)
    assert shift >= 20 / math.hypot(200, 200)


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e308])
def test_a_lens_beyond_numbers_has_no_small_shift(value):
    lens = Distortion(value, -value, value, k3=value)
    assert not lens.largest_shift(INTRINSICS, 200, 200) < math.inf
    assert lens.is_finite == (value == 1e308)


def test_folding_by_hand():
    # d/dr (r + k3 r^7) = 1 + 7 k3 r^6 is 0 at r2 = 2 for k3 = -1/56.
    assert not Distortion(k3=-0.99 / 56).folds(CORNER)
    assert Distortion(k3=-1.01 / 56).folds(CORNER)
