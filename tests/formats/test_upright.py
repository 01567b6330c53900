import math

import pytest
import torch

from instok3d.formats.upright import FLIP, y_up
from instok3d.scene.vertical import Vertical

DIRECTIONS = [(0.0, -1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.0, 0.8),
              (-0.48, -0.6, 0.64), (0.0, math.sin(-1e-4), math.cos(1e-4))]  # fmt: skip


@pytest.mark.parametrize("up", DIRECTIONS)
def test_up_becomes_y_by_a_rotation(up: tuple[float, float, float]):
    rotation = y_up(Vertical(up, "given cameras", 0.9))
    torch.testing.assert_close(rotation @ torch.tensor(up), torch.tensor([0.0, 1, 0]))
    torch.testing.assert_close(rotation @ rotation.mT, torch.eye(3))
    assert float(torch.linalg.det(rotation)) == pytest.approx(1)


def test_an_opencv_world_is_turned_half_around_x():
    assert torch.equal(y_up(Vertical((0.0, -1.0, 0.0), "first camera", 0.9)), FLIP)
    assert torch.equal(y_up(Vertical((0.0, 0.0, 1.0), "given cameras", 0.1)), FLIP)
