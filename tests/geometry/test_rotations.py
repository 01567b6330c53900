import math

import torch

from instok3d.geometry.rotations import (
    angle_between_rad,
    matrix_to_quat,
    quat_multiply,
    quat_to_matrix,
)


def test_quarter_turn_about_z_takes_x_to_y():
    half = math.sqrt(0.5)
    matrix = quat_to_matrix(torch.tensor([half, 0.0, 0.0, half]))
    torch.testing.assert_close(matrix @ torch.tensor([1.0, 0, 0]), torch.tensor([0.0, 1.0, 0.0]))


def test_quaternion_survives_the_matrix_also_at_half_turns(rng):
    quats = torch.randn(200, 4, generator=rng, dtype=torch.float64)
    half_turns = torch.eye(4, dtype=torch.float64)[1:]
    quats = torch.cat([quats, half_turns])
    quats = quats / quats.norm(dim=-1, keepdim=True)
    back = matrix_to_quat(quat_to_matrix(quats))
    torch.testing.assert_close((back * quats).sum(-1).abs(), torch.ones(203, dtype=torch.float64))


def test_product_of_quaternions_is_the_product_of_matrices(rng):
    a, b = torch.randn(2, 50, 4, generator=rng, dtype=torch.float64)
    product = quat_to_matrix(a) @ quat_to_matrix(b)
    torch.testing.assert_close(quat_to_matrix(quat_multiply(a, b)), product)


def test_zero_quaternion_gives_finite_values_and_gradients():
    quat = torch.zeros(4, requires_grad=True)
    quat_to_matrix(quat).sum().backward()
    assert quat.grad is not None
    assert quat.grad.isfinite().all()


def test_angle_is_exact_where_the_cosine_is_flat():
    angle = 1e-4
    turned = quat_to_matrix(
        torch.tensor([math.cos(angle / 2), math.sin(angle / 2), 0.0, 0.0], dtype=torch.float64)
    )
    measured = angle_between_rad(torch.eye(3, dtype=torch.float64), turned)
    assert abs(float(measured) - angle) < 1e-12
