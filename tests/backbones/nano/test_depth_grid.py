"""The coarse grid of depth corrections: its size and its interpolation."""

import pytest
import torch
from torch.nn import functional

from instok3d.backbones.nano.depth_grid import coarse_grid, node_weights


def test_node_weights_are_bilinear_interpolation():
    nodes = torch.eye(6).view(6, 1, 2, 3)
    expected = functional.interpolate(nodes, size=(8, 12), mode="bilinear", align_corners=False)
    y, x = torch.meshgrid(torch.arange(8) + 0.5, torch.arange(12) + 0.5, indexing="ij")
    positions = torch.stack([x / 12, y / 8], dim=-1)
    weights = node_weights(positions, (2, 3))
    torch.testing.assert_close(weights, expected[:, 0].permute(1, 2, 0))
    torch.testing.assert_close(weights.sum(-1), torch.ones(8, 12))


@pytest.mark.parametrize(
    ("height", "width", "grid"), [(128, 128, (8, 8)), (96, 128, (6, 8)), (8, 256, (1, 8))]
)
def test_grid_has_square_cells_and_at_least_one(height, width, grid):
    assert coarse_grid(height, width) == grid
