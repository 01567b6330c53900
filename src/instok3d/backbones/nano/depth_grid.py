"""The coarse grid of log-depth corrections: its size, interpolation and prior."""

import torch
from jaxtyping import Float
from torch import Tensor

OWN_VARIANCE = 0.005
"""Share of the variance that each node has to itself. Exponential covariance alone leaves almost
no difference between neighbours."""


def coarse_grid(height: int, width: int, longest: int = 8) -> tuple[int, int]:
    """Rows and columns of nodes: `longest` along the longer side, cells about square."""
    side = max(height, width)
    return max(1, round(longest * height / side)), max(1, round(longest * width / side))


def node_weights(
    positions: Float[Tensor, "*batch 2"], grid: tuple[int, int]
) -> Float[Tensor, "*batch node"]:
    """Bilinear weights of the nodes at image positions x / width, y / height.

    Nodes lie at the centres of the grid's cells. This is what `interpolate(..., mode="bilinear",
    align_corners=False)` computes, at arbitrary positions.
    """
    per_axis = []
    for axis, nodes in ((1, grid[0]), (0, grid[1])):
        position = (positions[..., axis, None] * nodes - 0.5).clamp(0, nodes - 1)
        number = torch.arange(nodes, device=positions.device)
        per_axis.append((1 - (position - number).abs()).clamp_min(0))
    return (per_axis[0][..., :, None] * per_axis[1][..., None, :]).flatten(-2)


def prior_precision(
    grid: tuple[int, int], *, deviation: float, correlation_length: float
) -> Float[Tensor, "node node"]:
    """Inverse covariance of the corrections; the covariance is exponential in the distance.

    Args:
        grid: Rows and columns of nodes.
        deviation: Standard deviation of one correction, in log depth.
        correlation_length: In units of the grid's longer side.
    """
    rows, columns = grid
    nodes = torch.cartesian_prod(torch.arange(float(rows)), torch.arange(float(columns)))
    distance = torch.cdist(nodes, nodes) / max(grid)
    covariance = deviation**2 * torch.exp(-distance / correlation_length)
    covariance = covariance + OWN_VARIANCE * deviation**2 * torch.eye(len(nodes))
    return torch.linalg.inv(covariance)
