import pytest
import torch

from instok3d.geometry.camera_json import read_intrinsics, read_pose

EYE = torch.eye(4).tolist()
PINHOLE = [[40.0, 0, 16], [0, 40, 12], [0, 0, 1]]


def test_sound_cameras_are_read_in_double_precision():
    pose = [[0, 0, 1, 1e-12], [1, 0, 0, 2], [0, 1, 0, 3], [0, 0, 0, 1]]
    assert torch.equal(read_pose(pose, where="x"), torch.tensor(pose, dtype=torch.float64))
    found = read_intrinsics(PINHOLE, where="x", height=24, width=32)
    assert torch.equal(found, torch.tensor(PINHOLE, dtype=torch.float64))


@pytest.mark.parametrize("value", [None, 1, [], EYE[:3], [row[:3] for row in EYE], [[1] * 4] * 3])
def test_other_shapes_are_refused(value):
    with pytest.raises(ValueError, match=r"a.json: view 3 has a pose that is not 4 x 4 numbers"):
        read_pose(value, where="a.json: view 3")


@pytest.mark.parametrize("value", [None, "1", True, [1]])
def test_other_things_than_numbers_are_refused(value):
    wrong = [[*row] for row in EYE]
    wrong[0][0] = value
    with pytest.raises(ValueError, match=r"not 4 x 4 numbers: .* is no number"):
        read_pose(wrong, where="x")
    with pytest.raises(ValueError, match=r"x has intrinsics that are not 3 x 3 numbers"):
        read_intrinsics([row[:3] for row in wrong[:3]], where="x", height=24, width=32)


def test_cameras_that_cannot_be_are_refused():
    mirrored = [[-1.0, 0, 0, 0], *EYE[1:]]
    with pytest.raises(ValueError, match=r"x has a mirrored camera .*; give a rotation"):
        read_pose(mirrored, where="x")
    with pytest.raises(ValueError, match=r"x has the focal length 0"):
        read_intrinsics([[0, 0, 16], *PINHOLE[1:]], where="x", height=24, width=32)
    # Parts of photos may have their principal point outside, by one side of the picture.
    read_intrinsics([[40, 0, 63], *PINHOLE[1:]], where="x", height=24, width=32)
    with pytest.raises(ValueError, match=r"x has the principal point \(65, 12\)"):
        read_intrinsics([[40, 0, 65], *PINHOLE[1:]], where="x", height=24, width=32)
