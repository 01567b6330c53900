"""The annotations of the sources are checked while tests run."""

import pytest
import torch

from annotations import CHECKS
from instok3d.geometry.rotations import quat_to_matrix


def misuse() -> None:
    quat_to_matrix(torch.zeros(3, 3))


@pytest.mark.parametrize("test", ["first", "second"])
def test_a_wrong_shape_fails_in_every_test_until_a_function_was_called_often(test):
    with pytest.raises(Exception, match="Type-check error"):
        misuse()
    for _ in range(CHECKS):
        quat_to_matrix(torch.ones(1, 4))
    with pytest.raises(ValueError, match="not enough values to unpack"):
        misuse()
