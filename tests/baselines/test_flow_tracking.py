import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from instok3d.baselines.flow_tracking import carried, flow_between, tracked_by_flow
from instok3d.baselines.tracking import Link, joined, unmatched

SIDE = 64


def texture(seed: int = 0) -> np.ndarray:
    """Smooth noise over all of 0 to 1."""
    noise = gaussian_filter(np.random.default_rng(seed).random((SIDE, SIDE)), 1.5, mode="wrap")
    return (noise - noise.min()) / (noise.max() - noise.min())


def panned(shifts: list[int]) -> tuple[torch.Tensor, torch.Tensor]:
    """Views of one wall moved to the right, with four masks whose names change by the view."""
    columns = np.arange(SIDE) * 4 // SIDE
    names = np.tile(columns, (SIDE, 1))
    photos, masks = [], []
    for view, shift in enumerate(shifts):
        moved = torch.from_numpy(np.roll(texture(), shift, axis=1)).float()
        photos.append(moved.expand(3, -1, -1))
        masks.append(torch.from_numpy((np.roll(names, shift, axis=1) + view) % 4 + 1))
    return torch.stack(masks), torch.stack(photos)


def things(found: torch.Tensor, shifts: list[int]) -> list[set[int]]:
    """Ids that each quarter of the wall has over all views."""
    still = torch.stack([each.roll(-s, 1) for each, s in zip(found, shifts, strict=True)])
    quarters = still.unflatten(2, (4, SIDE // 4)).movedim(2, 0).flatten(1)
    return [set(each.tolist()) for each in quarters]


def test_flow_of_a_moved_picture_is_the_shift():
    first = (texture() * 255).astype(np.uint8)
    flow = flow_between(first, np.roll(first, (2, 3), axis=(0, 1)))
    assert flow.shape == (SIDE, SIDE, 2)
    np.testing.assert_allclose(np.median(flow, axis=(0, 1)), [3, 2], atol=0.05)


def test_masks_that_move_with_the_picture_keep_one_id():
    shifts = [0, 3, 6, 9]
    masks, photos = panned(shifts)
    found = tracked_by_flow(masks, photos)
    assert sorted(things(found, shifts), key=min) == [{1}, {2}, {3}, {4}]


def test_a_mask_that_one_view_misses_is_the_same_thing_before_and_after():
    shifts = [0, 3, 6]
    masks, photos = panned(shifts)
    masks[1][masks[1] == 2] = 0
    found = tracked_by_flow(masks, photos)
    assert torch.equal(found > 0, masks > 0)
    assert sorted(len(each - {0}) for each in things(found, shifts)) == [1, 1, 1, 1]


def test_a_pixel_that_does_not_come_back_or_leaves_the_picture_shows_nothing():
    here = torch.ones(20, 20, dtype=torch.int64)
    there = torch.full((20, 20), 2)
    right = np.zeros((20, 20, 2))
    right[..., 0] = 4.0
    assert carried(here, there, right, -right) == [Link(1, 2, 1.0)]
    assert carried(here, there, right, np.zeros_like(right)) == []  # 4 pixels off
    assert carried(here, there, 6 * right, -6 * right) == []  # beyond the border
    there[:, :12] = 3  # of the 16 columns that come to lie in the picture, 8 are of 2 and 8 of 3
    assert carried(here, there, right, -right) == [Link(1, 2, 0.5), Link(1, 3, 0.5)]


def test_no_view_no_mask_and_one_view():
    masks, photos = panned([0, 3])
    none = tracked_by_flow(torch.zeros_like(masks), photos)
    assert not none.any()
    assert tracked_by_flow(masks[:0], photos[:0]).shape == (0, SIDE, SIDE)
    assert torch.equal(tracked_by_flow(masks[:1], photos[:1]), unmatched(masks[:1]))


def test_too_small_photos_are_named():
    with pytest.raises(ValueError, match="at least 12 pixels, got 8 x 11"):
        tracked_by_flow(torch.ones(2, 8, 11, dtype=torch.int64), torch.zeros(2, 3, 8, 11))


def test_the_best_link_wins_and_no_thing_gets_two_masks_of_a_view():
    masks = torch.tensor([[[1, 2]], [[3, 4]]])
    links = [Link(1, 3, 0.4), Link(2, 3, 0.9), Link(1, 4, 0.3)]
    assert joined(masks, links).tolist() == [[[1, 2]], [[2, 1]]]
    assert joined(masks, [Link(1, 3, 0.5), Link(3, 2, 0.4)]).tolist() == [[[1, 2]], [[1, 3]]]
