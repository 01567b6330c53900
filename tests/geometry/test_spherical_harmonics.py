import math

import pytest
import torch
from torch.nn import functional

from harmonics import harmonic
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.geometry.spherical_harmonics import evaluate_sh, rotate_sh, sh_basis


def directions(count, rng):
    return functional.normalize(torch.randn(count, 3, generator=rng, dtype=torch.float64), dim=-1)


def test_first_degree_by_hand():
    # The signs of 3DGS: Y0 = 1/(2 sqrt(pi)); Y1 = sqrt(3/(4 pi)) * (-y, z, -x).
    sh = torch.tensor([[2.0], [3.0], [5.0], [7.0]])
    direction = torch.tensor([0.6, 0.0, 0.8])
    expected = 2 / (2 * math.sqrt(math.pi)) + math.sqrt(3 / (4 * math.pi)) * (5 * 0.8 - 7 * 0.6)
    torch.testing.assert_close(evaluate_sh(sh, direction), torch.tensor([expected]))


def test_basis_is_orthonormal_over_the_sphere():
    # Gauss points in z and even angles integrate polynomials of degree 6 exactly.
    z, weight = (torch.tensor(v, dtype=torch.float64) for v in _legendre_four())
    angle = torch.arange(8, dtype=torch.float64) * (2 * math.pi / 8)
    radius = (1 - z * z).sqrt()[:, None]
    points = torch.stack([radius * angle.cos(), radius * angle.sin(), z[:, None].expand(4, 8)], -1)
    basis = sh_basis(points, 3).view(32, 16)
    weights = (weight[:, None] * (2 * math.pi / 8)).expand(4, 8).reshape(32, 1)
    torch.testing.assert_close(basis.T @ (basis * weights), torch.eye(16, dtype=torch.float64))


def _legendre_four():
    inner, outer = (math.sqrt(3 / 7 + s * 2 / 7 * math.sqrt(6 / 5)) for s in (-1, 1))
    heavy, light = ((18 + s * math.sqrt(30)) / 36 for s in (1, -1))
    return [-outer, -inner, inner, outer], [light, heavy, heavy, light]


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_rotated_coefficients_show_the_same_in_rotated_directions(coefficients, rng):
    sh = torch.randn(5, coefficients, 3, generator=rng, dtype=torch.float64)
    each = quat_to_matrix(torch.randn(5, 4, generator=rng, dtype=torch.float64))
    seen_from = directions(5, rng)
    for rotation in (each, each[0]):
        turned = (rotation @ seen_from[..., None]).squeeze(-1)
        torch.testing.assert_close(
            evaluate_sh(rotate_sh(sh, rotation), turned), evaluate_sh(sh, seen_from)
        )


def test_other_counts_of_coefficients_are_refused():
    with pytest.raises(ValueError, match="7 coefficients"):
        evaluate_sh(torch.zeros(7, 3), torch.tensor([0.0, 0.0, 1.0]))


def test_no_gaussians_have_no_colours():
    assert evaluate_sh(torch.zeros(0, 9, 3), torch.zeros(0, 3)).shape == (0, 3)
    assert rotate_sh(torch.zeros(0, 9, 3), torch.eye(3)).shape == (0, 9, 3)


def test_every_basis_function_is_the_published_one_with_its_sign(rng):
    places = directions(50, rng)
    found = sh_basis(places, 3).numpy()
    for number in range(16):
        expected = harmonic(number, places.numpy())
        assert abs(found[:, number] - expected).max() < 1e-7, number
        assert abs(expected).max() > 0.2
