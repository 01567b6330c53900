"""Real spherical harmonics of degree 0 to 3, in the order and with the signs of 3DGS and gsplat."""

from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

DEGREE_OF_COUNT = {1: 0, 4: 1, 9: 2, 16: 3}
SH_CONSTANT = 0.28209479177387814
"""The constant basis function, 1 / (2 sqrt(pi)): colour = 0.5 + SH_CONSTANT * coefficient 0."""


def sh_degree(sh: Float[Tensor, "*batch coefficient channel"]) -> int:
    """The degree that a number of coefficients stands for.

    Raises:
        ValueError: The number of coefficients is not 1, 4, 9 or 16.
    """
    count = sh.shape[-2]
    if count not in DEGREE_OF_COUNT:
        raise ValueError(f"sh has {count} coefficients a colour; it must have 1, 4, 9 or 16")
    return DEGREE_OF_COUNT[count]


def sh_basis(
    directions: Float[Tensor, "*batch 3"], degree: int
) -> Float[Tensor, "*batch coefficient"]:
    """Values of the (degree + 1)^2 basis functions in unit directions."""
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    values = [torch.full_like(x, SH_CONSTANT)]
    if degree > 0:
        values += [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    if degree > 1:
        values += [
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * zz - xx - yy),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (xx - yy),
        ]
    if degree > 2:
        values += [
            -0.5900435899266435 * y * (3 * xx - yy),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * zz - xx - yy),
            0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
            -0.4570457994644658 * x * (4 * zz - xx - yy),
            1.445305721320277 * z * (xx - yy),
            -0.5900435899266435 * x * (xx - 3 * yy),
        ]
    return torch.stack(values, dim=-1)


def evaluate_sh(
    sh: Float[Tensor, "*batch coefficient channel"], directions: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch channel"]:
    """Values in unit directions; a colour is max(value + 0.5, 0), which is left to the caller.

    Args:
        sh: Coefficients of degree 0 to 3, number 0 is the constant term.
        directions: Unit vectors from the camera to the Gaussian, world frame.

    Raises:
        ValueError: The number of coefficients is not 1, 4, 9 or 16.
    """
    return (sh_basis(directions, sh_degree(sh))[..., None] * sh).sum(-2)


def rotate_sh(
    sh: Float[Tensor, "*batch coefficient channel"], rotation: Float[Tensor, "*rotation 3 3"]
) -> Float[Tensor, "*batch coefficient channel"]:
    """Coefficients of the same radiance after its carrier was turned by `rotation`, exactly.

    `evaluate_sh(rotate_sh(sh, R), R d) == evaluate_sh(sh, d)`: a rotation maps each band to
    itself, so its matrix follows from the values of the band in a few directions.

    Args:
        sh: Coefficients of degree 0 to 3.
        rotation: One rotation for all, or one for each (its leading axes broadcast to sh's).

    Raises:
        ValueError: The number of coefficients is not 1, 4, 9 or 16.
    """
    degree = sh_degree(sh)
    bands = [sh[..., :1, :]]
    directions = _directions().to(rotation)
    turned_back = sh_basis(directions @ rotation, degree)
    for band in range(1, degree + 1):
        span = slice(band * band, (band + 1) ** 2)
        matrix = _band_solver(band).to(rotation) @ turned_back[..., span]
        bands.append(matrix @ sh[..., span, :])
    return torch.cat(bands, dim=-2)


@cache
def _directions() -> Float[Tensor, "direction 3"]:
    """Unit vectors spread evenly over the sphere (a golden spiral)."""
    index = torch.arange(24, dtype=torch.float64)
    z = 1 - (2 * index + 1) / len(index)
    angle_rad = index * torch.pi * (3 - 5**0.5)
    radius = (1 - z * z).sqrt()
    return torch.stack([radius * angle_rad.cos(), radius * angle_rad.sin(), z], dim=-1)


@cache
def _band_solver(band: int) -> Float[Tensor, "coefficient direction"]:
    """Takes the values of one band in `_directions` to its coefficients."""
    return torch.linalg.pinv(sh_basis(_directions(), band)[:, band * band :])
