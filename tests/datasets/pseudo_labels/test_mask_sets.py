import numpy as np

from instok3d.datasets.pseudo_labels.mask_sets import (
    overlap_ious,
    painted,
    suppressed,
    visible_shares,
    without_small_regions,
)


def row(text: str) -> np.ndarray:
    """A mask of one row: x is in it."""
    return np.array([[letter == "x" for letter in text]])


def test_overlaps_by_hand():
    masks = np.stack([row("xxxx...."), row("..xxxx.."), row("........")])
    # 2 shared of 6; nothing shared with an empty one, and 0 / 0 counts as 0
    np.testing.assert_allclose(
        overlap_ious(masks, masks), [[1, 2 / 6, 0], [2 / 6, 1, 0], [0, 0, 0]], atol=1e-12
    )
    assert overlap_ious(masks[:0], masks).shape == (0, 3)


def test_large_masks_are_counted_exactly_over_several_blocks(monkeypatch):
    rng = np.random.default_rng(0)
    masks, others = rng.random((3, 20, 30)) < 0.4, rng.random((2, 20, 30)) < 0.4
    whole = overlap_ious(masks, others)
    monkeypatch.setattr("instok3d.datasets.pseudo_labels.mask_sets._PIXELS_AT_ONCE", 7)
    np.testing.assert_array_equal(overlap_ious(masks, others), whole)
    assert whole[1, 1] == (masks[1] & others[1]).sum() / (masks[1] | others[1]).sum()


def test_the_better_of_two_like_masks_stays():
    masks = np.stack([row("xxxx...."), row("xxxxx..."), row("......xx"), row("xxxx....")])
    scores = np.array([0.8, 0.9, 0.5, 0.8])
    # 1 takes out 0 and 3 (IoU 4/5); 2 is elsewhere
    assert suppressed(masks, scores, 0.7).tolist() == [1, 2]
    assert suppressed(masks, scores, 0.8).tolist() == [1, 0, 2]  # not more than 4/5; 3 is 0 again
    assert suppressed(masks[:0], scores[:0], 0.5).tolist() == []


def test_a_taken_out_mask_takes_none_out():
    # b is like a, c like b but not like a: a takes b out, so c stays
    a, b, c = row("xxxx...."), row(".xxxx..."), row("..xxxx..")
    assert suppressed(np.stack([a, b, c]), np.array([3.0, 2.0, 1.0]), 0.5).tolist() == [0, 2]


def test_small_islands_go_and_small_holes_are_filled():
    mask = np.zeros((8, 8), dtype=bool)
    mask[1:6, 1:6] = True
    clean = mask.copy()
    mask[3, 3] = False  # a hole of one
    mask[7, 7] = True  # an island of one
    np.testing.assert_array_equal(without_small_regions(mask, 2), clean)
    np.testing.assert_array_equal(without_small_regions(mask, 1), mask)


def test_of_islands_that_are_all_small_the_largest_stays():
    assert without_small_regions(row("xx....x....."), 4).tolist() == row("xx..........").tolist()
    assert not without_small_regions(row("........"), 4).any()


def test_smaller_masks_lie_on_larger_ones():
    masks = [row("..xx...."), row("xxxxxx.."), row("....xxxx")]
    ids = painted(masks, [0.1, 0.9, 0.5], [7, 8, 9], (1, 8))
    assert ids.tolist() == [[8, 8, 7, 7, 9, 9, 9, 9]]
    assert ids.dtype == np.uint16


def test_of_equal_masks_the_surer_is_on_top():
    masks = [row("xx.."), row("xx..")]
    assert painted(masks, [0.9, 0.8], [1, 2], (1, 4)).tolist() == [[1, 1, 0, 0]]
    assert painted(masks, [0.8, 0.9], [1, 2], (1, 4)).tolist() == [[2, 2, 0, 0]]


def test_ids_above_255_and_no_masks_are_fine():
    assert painted([row("x.")], [1.0], [65535], (1, 2)).tolist() == [[65535, 0]]
    assert painted([], [], [], (1, 2)).tolist() == [[0, 0]]


def test_visible_shares_by_hand():
    masks = np.stack([row("xxxxxxxx"), row("xx......"), row("...x....")])
    np.testing.assert_allclose(visible_shares(masks), [5 / 8, 1, 1])
    assert visible_shares(masks[:0]).shape == (0,)
