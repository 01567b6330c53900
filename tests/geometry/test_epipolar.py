import torch

from instok3d.geometry.cameras import project, rigid, transform_points
from instok3d.geometry.epipolar import BEHIND_PX, match_errors
from instok3d.geometry.registration import rigid_from_twist

INTRINSICS = torch.tensor([[100.0, 0, 64], [0, 100, 64], [0, 0, 1]])


def shifted(x: float) -> torch.Tensor:
    return rigid(torch.eye(3), torch.tensor([x, 0.0, 0.0]))


def errors(a: list[float], b: list[float], b_from_a: torch.Tensor) -> float:
    pixels_a, pixels_b = torch.tensor([a]).float(), torch.tensor([b]).float()
    return float(match_errors(pixels_a, pixels_b, b_from_a, INTRINSICS, INTRINSICS)[0])


def test_distances_from_half_a_line_by_hand():
    # b stands to the left of a (its points move by +x): a point at the middle of a lies in b
    # at 64 (infinitely far) or anywhere to the right of it.
    assert errors([64, 64], [64, 64], shifted(0.5)) < 1e-3
    assert errors([64, 64], [90, 64], shifted(0.5)) < 1e-3
    assert abs(errors([64, 64], [90, 69], shifted(0.5)) - 5) < 0.3
    # Of the reverse motion that is the wrong half: the infinitely far point, 26 away, is nearest.
    assert abs(errors([64, 64], [90, 64], shifted(-0.5)) - 26) < 1e-3


def test_true_matches_have_no_error_and_inverted_cameras_do(rng: torch.Generator):
    points = torch.rand(200, 3, generator=rng) * torch.tensor([2.0, 2, 2]) + torch.tensor(
        [-1, -1, 3]
    )
    b_from_a = rigid_from_twist(torch.tensor([0.3, -0.1, 0.1, 0.05, 0.2, -0.03]))
    a, b = project(points, INTRINSICS), project(transform_points(b_from_a, points), INTRINSICS)
    several = torch.stack([b_from_a, b_from_a.inverse()])
    right, inverse = match_errors(a, b, several, INTRINSICS, INTRINSICS)
    assert float(right.max()) < 1e-2
    assert float(inverse.median()) > 10


def test_cameras_at_one_place_are_compared_by_their_rotation_alone():
    turn = rigid_from_twist(torch.tensor([0.0, 0, 0, 0, 0.1, 0]))
    expected = 64 + 100 * float(torch.tensor(0.1).tan())
    assert errors([64, 64], [expected, 64], turn) < 1e-2
    assert errors([64, 64], [expected + 7, 64], turn) > 5


def test_what_lies_behind_a_camera_cannot_be_seen():
    about = rigid_from_twist(torch.tensor([0.0, 0, 0, 0, torch.pi, 0]))
    assert errors([64, 64], [64, 64], about) == BEHIND_PX


def test_no_match_has_no_error():
    none = torch.zeros(0, 2)
    assert match_errors(none, none, shifted(1.0), INTRINSICS, INTRINSICS).shape == (0,)
