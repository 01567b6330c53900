import math

import pytest
import torch

from instok3d.geometry.rotations import quat_to_matrix
from instok3d.scene.boxes import describe_shape
from instok3d.types import Gaussians


def grid(opacity: float = 0.9) -> Gaussians:
    """Gaussians of almost no size on an 11 x 5 x 3 grid over [0, 4] x [0, 2] x [0, 1]."""
    axes = [torch.linspace(0, end, count) for end, count in ((4.0, 11), (2.0, 5), (1.0, 3))]
    means = torch.cartesian_prod(*axes)
    count = len(means)
    return Gaussians(
        means=means,
        quats=torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),
        scales=torch.full((count, 3), 1e-6),
        opacities=torch.full((count,), opacity),
        sh=torch.zeros(count, 1, 3),
        anchor_index=torch.zeros(count, dtype=torch.long),
    )


def join(first: Gaussians, second: Gaussians) -> Gaussians:
    pairs = zip(vars(first).values(), vars(second).values(), strict=True)
    return Gaussians(*(torch.cat(pair) for pair in pairs))


def test_boxes_of_a_grid_by_hand():
    # Every face holds at least 1/11 of the weight, more than the tail, so the boxes reach it.
    aabb, obb, centroid = describe_shape(grid())
    assert aabb.min == pytest.approx((0, 0, 0), abs=1e-5)
    assert aabb.max == pytest.approx((4, 2, 1), abs=1e-5)
    assert centroid == pytest.approx((2, 1, 0.5), abs=1e-5)
    assert obb.center == pytest.approx((2, 1, 0.5), abs=1e-5)
    assert obb.size == pytest.approx((4, 2, 1), abs=1e-5)


def test_an_oriented_box_turns_with_its_object():
    angle_rad = 0.5
    turn = torch.tensor([math.cos(angle_rad / 2), 0, 0, math.sin(angle_rad / 2)])
    straight = grid()
    means = straight.means @ quat_to_matrix(turn).mT
    _, obb, _ = describe_shape(Gaussians(**{**vars(straight), "means": means}))
    assert obb.size == pytest.approx((4, 2, 1), abs=1e-4)
    longest = quat_to_matrix(torch.tensor(obb.quat_wxyz))[:, 0]
    assert abs(float(longest @ quat_to_matrix(turn)[:, 0])) == pytest.approx(1, abs=1e-5)
    assert float(torch.linalg.det(quat_to_matrix(torch.tensor(obb.quat_wxyz)))) == pytest.approx(1)


def test_faint_strays_do_not_widen_the_boxes():
    stray = grid(opacity=0.01)
    far = Gaussians(**{**vars(stray), "means": stray.means + 50})
    aabb, obb, _ = describe_shape(join(grid(), far))
    assert aabb.max == pytest.approx((4, 2, 1), abs=1e-4)
    assert max(obb.size) < 5


def test_one_gaussian_has_the_extent_of_its_standard_deviations():
    one = Gaussians(
        means=torch.tensor([[1.0, 2, 3]]),
        quats=torch.tensor([[1.0, 0, 0, 0]]),
        scales=torch.tensor([[0.3, 0.2, 0.1]]),
        opacities=torch.tensor([0.0]),
        sh=torch.zeros(1, 1, 3),
        anchor_index=torch.zeros(1, dtype=torch.long),
    )
    aabb, obb, centroid = describe_shape(one)
    assert aabb.min == pytest.approx((0.7, 1.8, 2.9))
    assert aabb.max == pytest.approx((1.3, 2.2, 3.1))
    assert obb.size == pytest.approx((0.6, 0.4, 0.2))
    assert centroid == pytest.approx((1, 2, 3))
