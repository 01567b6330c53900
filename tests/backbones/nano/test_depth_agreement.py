"""Depths that come together where views see one surface, and nowhere else."""

import torch

from instok3d.backbones.nano.depth_agreement import AGREEMENT, agree_on_depths

SIZE = 16
INTRINSICS = torch.tensor([[16.0, 0, 8], [0, 16.0, 8], [0, 0, 1]])


def changes(
    *distances: float, confidences: tuple[float, ...] | None = None, shift: float = 0.0
) -> torch.Tensor:
    """Of views side by side, each of which takes the wall before it for so far away."""
    count = len(distances)
    depths = torch.stack([torch.full((SIZE, SIZE), d) for d in distances])[None]
    sure = torch.tensor(confidences or (1.0,) * count).view(1, count, 1, 1).expand_as(depths)
    cameras = torch.eye(4).repeat(1, count, 1, 1)
    cameras[0, :, 0, 3] = -shift * torch.arange(count)
    return agree_on_depths(depths, sure, cameras, INTRINSICS.expand(1, count, 3, 3))[0]


def test_two_views_meet_by_hand():
    # ln 1.02 = 0.0198 apart: weight exp(-0.0198^2 / 2 / 0.06^2) = 0.947, share 0.947 / 1.947.
    log = torch.tensor(1.02).log()
    weight = torch.exp(-0.5 * (log / AGREEMENT).square())
    change = changes(2.0, 2.04)
    torch.testing.assert_close(change[0], (log * weight / (1 + weight)).expand(SIZE, SIZE))
    torch.testing.assert_close(change[1], -change[0])


def test_the_surer_view_moves_less():
    change = changes(2.0, 2.04, confidences=(9.0, 1.0))
    assert change[0].max() < 0.2 * change[1].abs().min()


def test_other_surfaces_are_left_alone():
    assert changes(2.0, 3.0).abs().max() < 1e-6


def test_what_a_view_does_not_see_stays():
    # The second camera stands 1 to the right: from depth 2, half of the first one's width.
    change = changes(2.0, 2.04, shift=1.0)
    assert change[0, :, :7].count_nonzero() == 0
    assert (change[0, :, 9:] > 0.005).all()


def test_one_view_and_agreeing_views_change_nothing():
    assert changes(2.0).count_nonzero() == 0
    assert changes(2.0, 2.0, 2.0).abs().max() < 1e-6


def test_looking_away_from_each_other_all_stays_finite():
    depths = torch.full((1, 2, SIZE, SIZE), 2.0)
    cameras = torch.eye(4).repeat(1, 2, 1, 1)
    cameras[0, 1, 0, 0] = cameras[0, 1, 2, 2] = -1
    change = agree_on_depths(
        depths, torch.ones_like(depths), cameras, INTRINSICS.expand(1, 2, 3, 3)
    )
    assert change.count_nonzero() == 0
