import pytest
import torch

from instok3d.objectives.distillation import distillation_loss

# One scene, one view, one row of four pixels, features of two channels.
TEACHER = torch.tensor([[1.0, 0], [1, 0], [0, 1], [0, 1]]).T[None, None, :, None]


def loss(features, shares, shared, *, min_pixels=1.0):
    return distillation_loss(
        torch.tensor(features).T[None, None, :, None],
        torch.tensor(shares)[None, None, :, None, None],
        torch.tensor(shared)[None, :, None],
        TEACHER,
        min_pixels=min_pixels,
    )


def test_both_terms_by_hand():
    # Pixels: cos = 1, 0, 1, 1 / sqrt(2). Group 0 has the first two pixels, whose mean is (1, 0),
    # and points to (1, 1); group 1 has the third and fourth and points away.
    found = loss(
        [[2.0, 0], [0, 1], [0, 5], [1, 1]],
        [[1.0, 1, 0, 0], [0, 0, 1, 1]],
        [[1.0, 1], [0, -1]],
    )
    root = 0.5**0.5
    assert float(found.pixels) == pytest.approx((0 + 1 + 0 + 1 - root) / 4)
    assert float(found.groups) == pytest.approx((1 - root + 2) / 2)
    assert float(found.total) == pytest.approx(float(found.pixels + found.groups))


def test_masks_are_soft_and_small_groups_are_left_out():
    # Group 0 has 2.4 pixels, 2/3 of them like (1, 0): the mean points along (1.6, .8).
    shares = [[0.8, 0.8, 0.4, 0.4], [0.0, 0.0, 0.1, 0.1]]
    found = loss([[1.0, 0], [1, 0], [0, 1], [0, 1]], shares, [[1.0, 0], [1, 0]])
    assert float(found.groups) == pytest.approx(1 - 1.6 / (1.6**2 + 0.8**2) ** 0.5)
    assert float(found.pixels) == pytest.approx(0, abs=1e-6)
    assert float(loss([[1.0, 0]] * 4, shares, [[1.0, 0]] * 2, min_pixels=9.0).groups) == 0


def test_several_shared_features_are_averaged_by_the_mask():
    shares = torch.tensor([[3.0, 0, 0, 0], [0, 0, 1, 0]])[None, None, None, :, None, :]
    shared = torch.tensor([[[[1.0, 0], [0, 1]]]])
    found = distillation_loss(TEACHER, shares, shared, TEACHER, min_pixels=1.0)
    assert float(found.groups) == pytest.approx(0, abs=1e-6)  # (3, 1) / 4 against (3, 1)


def test_masks_get_no_gradient():
    shares = torch.ones(1, 1, 1, 1, 1, 4, requires_grad=True)
    shared = torch.ones(1, 1, 1, 2, requires_grad=True)
    features = torch.rand(1, 1, 2, 1, 4, requires_grad=True)
    distillation_loss(features, shares, shared, TEACHER, min_pixels=1.0).total.backward()
    assert shares.grad is None
    assert shared.grad is not None
    assert features.grad is not None
