import math

import pytest
import torch

from instok3d.geometry.cameras import rigid
from instok3d.geometry.checks import check_intrinsics, check_rigid, rigid_fault
from instok3d.geometry.rotations import quat_to_matrix

EYE = torch.eye(4).double()


def changed(matrix: torch.Tensor, *entries: tuple[int, int, float]) -> torch.Tensor:
    matrix = matrix.clone()
    for row, column, value in entries:
        matrix[row, column] = value
    return matrix


def pinhole(**entries: float) -> torch.Tensor:
    values = {"fx": 500.0, "skew": 0.0, "fy": 510.0, "cx": 320.0, "cy": 240.0, **entries}
    rows = [[values["fx"], values["skew"], values["cx"]], [0, values["fy"], values["cy"]]]
    return torch.tensor([*rows, [0, 0, 1]]).double()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_rigid_transforms_come_back_exactly_rigid(rng, dtype):
    quats = torch.randn(20, 4, generator=rng, dtype=torch.float64)
    poses = rigid(quat_to_matrix(quats), 1e3 * torch.randn(20, 3, generator=rng).double())
    rounded = torch.cat([(poses[:, :3] * 1000).round() / 1000, poses[:, 3:]], dim=1)
    for pose in rounded.to(dtype):
        exact = check_rigid(pose, where="a.json: 1.jpg")
        assert exact.dtype == dtype
        tolerance = 1e-6 if dtype == torch.float32 else 1e-12
        gram = exact[:3, :3] @ exact[:3, :3].T
        torch.testing.assert_close(gram, torch.eye(3, dtype=dtype), atol=tolerance, rtol=0)
        torch.testing.assert_close(exact, pose, atol=2e-3, rtol=0)
        assert torch.equal(exact[:, 3], pose[:, 3])


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (EYE[:3], "pose of 3 x 4 numbers instead of 4 x 4"),
        (torch.zeros(0, 0).double(), "pose of 0 x 0 numbers"),
        (changed(EYE, (0, 3, math.nan)), "not finite"),
        (changed(EYE, (1, 1, -math.inf)), "not finite"),
        (changed(EYE, (3, 0, 1.0)), "last row is 1 0 0 1, not 0 0 0 1"),
        (changed(EYE, (3, 3, 2.0)), "last row is 0 0 0 2"),
        (changed(EYE, (0, 1, 0.1)), r"not orthonormal \(off by 0.1\)"),
        (2 * EYE - changed(0 * EYE, (3, 3, 1.0)), r"not orthonormal \(off by 3\)"),
        (changed(0 * EYE, (3, 3, 1.0)), "not orthonormal"),
        (changed(EYE, (0, 0, 1e200), (1, 0, -1e200)), "not orthonormal"),
        (changed(EYE, (2, 2, -1.0)), "mirrored camera"),
        (changed(EYE, (0, 3, 1e30)), r"stands 1e\+30 units from the origin"),
        (changed(EYE, (1, 3, -1e300)), "stands .* units from the origin"),
    ],
)
def test_what_is_not_rigid_is_refused_with_its_fault(matrix, message):
    with pytest.raises(ValueError, match=rf"^a\.json: 1\.jpg .*{message}.*; wanted a rotation"):
        check_rigid(matrix, where="a.json: 1.jpg")
    assert rigid_fault(matrix) is not None


def test_the_tolerance_of_rotations_can_be_raised():
    sheared = changed(EYE, (0, 1, 0.01))
    assert rigid_fault(sheared) is not None
    assert rigid_fault(sheared, tolerance=0.02) is None


def test_pinholes_pass():
    check_intrinsics(pinhole(), where="x", width=640, height=480)
    check_intrinsics(pinhole().float(), where="x", width=640, height=480)
    check_intrinsics(pinhole(skew=0.05, cx=0.0, cy=480.0), where="x", width=640, height=480)
    check_intrinsics(pinhole(cx=-600.0), where="x", width=640, height=480, margin=1.0)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (pinhole()[:2], "intrinsics of 2 x 3 numbers instead of 3 x 3"),
        (pinhole(fx=math.nan), "not finite"),
        (pinhole(cy=math.inf), "not finite"),
        (pinhole(fx=-500.0), "focal length -500, which must be above 0"),
        (pinhole(fy=0.0), "focal length 0, which must be above 0"),
        (changed(pinhole(), (1, 0, 5.0)), "5 below the diagonal"),
        (changed(pinhole(), (2, 0, 0.5)), "last row is 0.5 0 1, not 0 0 1"),
        (changed(pinhole(), (2, 2, 0.0)), "last row is 0 0 0"),
        (pinhole(skew=20.0), "skew of 20"),
        (pinhole(fx=0.8, fy=1.0, cx=0.5, cy=0.5), "focal lengths 0.8 and 1, .* another size"),
        (pinhole(fx=1e30), "another size"),
        (pinhole(cx=960.0), r"principal point \(960, 240\), .* another size"),
        (pinhole(cy=-1.0), "principal point"),
    ],
)
def test_what_is_no_pinhole_of_the_image_is_refused_with_its_fault(matrix, message):
    with pytest.raises(ValueError, match=rf"^a\.json: 1\.jpg .*{message}.* 640 x 480 image"):
        check_intrinsics(matrix, where="a.json: 1.jpg", width=640, height=480)


@pytest.mark.parametrize(("width", "height"), [(0, 480), (640, -1), (10**9, 480)])
def test_images_without_a_size_are_refused(width, height):
    with pytest.raises(ValueError, match=f"cannot have {width} x {height} pixels"):
        check_intrinsics(pinhole(), where="x", width=width, height=height)
