from collections.abc import Callable

import pytest
import torch

from instok3d.backbones.nano.common_points import CommonPoints
from instok3d.geometry.cameras import invert_rigid, project, rigid, transform_points
from instok3d.geometry.registration import rigid_from_twist
from instok3d.scene.camera_check import EVIDENCE_SHARE, camera_notes
from instok3d.scene.paths import look_at

COUNT = 5
INTRINSICS = torch.tensor([[120.0, 0, 64], [0, 120, 64], [0, 0, 1]]).expand(COUNT, 3, 3)
NAMES = [f"{index}.jpg" for index in range(COUNT)]


@pytest.fixture
def cameras() -> torch.Tensor:
    """On an arc about a point, tilted and at different heights, in a z-up world."""
    angle_rad = 0.3 * torch.arange(COUNT)
    height = torch.tensor([1.2, 1.6, 1.1, 1.7, 1.4])
    centers = torch.stack([3 * angle_rad.cos(), 3 * angle_rad.sin(), height], dim=1)
    targets = torch.tensor([0.0, 0.2, 0.8]).expand(COUNT, 3)
    return look_at(centers, targets, torch.tensor([0.0, 0.0, -1.0]))


def seen_points(cameras: torch.Tensor, share: float = 0.3) -> list[CommonPoints]:
    """What pairs of neighbours, and of every second view, see of one cloud; a tenth is wrong."""
    generator = torch.Generator().manual_seed(0)
    cloud = torch.rand(300, 3, generator=generator) * 1.6 - torch.tensor([0.8, 0.6, 0.0])
    pixels = project(transform_points(cameras, cloud.expand(COUNT, -1, -1)), INTRINSICS)
    pixels = pixels + 0.7 * torch.randn(pixels.shape, generator=generator)
    found = []
    for a, b in [(0, 1), (1, 2), (2, 3), (3, 4), (0, 2), (1, 3), (2, 4)]:
        of_b = pixels[b].clone()
        of_b[:30] = 128 * torch.rand(30, 2, generator=generator)
        found.append(CommonPoints(a, b, pixels[a], of_b, share))
    return found


def notes(points: list[CommonPoints], cameras: torch.Tensor) -> list[str]:
    return camera_notes(points, cameras, INTRINSICS, NAMES)


def test_right_cameras_pass_in_any_world_and_unit(cameras: torch.Tensor):
    points = seen_points(cameras)
    assert notes(points, cameras) == []
    moved = cameras @ invert_rigid(cameras[3:4])
    moved[:, :3, 3] *= 1000
    assert notes(points, moved) == []


def flipped(cameras: torch.Tensor) -> torch.Tensor:
    return torch.diag(torch.tensor([1.0, -1, -1, 1])) @ cameras


def with_centers(cameras: torch.Tensor) -> torch.Tensor:
    wrong = cameras.clone()
    wrong[:, :3, 3] = invert_rigid(cameras)[:, :3, 3]
    return wrong


def with_z_up(cameras: torch.Tensor) -> torch.Tensor:
    turn = torch.tensor([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    return turn @ cameras


@pytest.mark.parametrize(
    ("mix_up", "why"),
    [
        (invert_rigid, "the matrices were inverted"),
        (flipped, "y and z of the camera axes were reversed (OpenGL"),
        (lambda cameras: flipped(invert_rigid(cameras)), "the matrices were inverted"),
        (lambda cameras: invert_rigid(flipped(cameras)), "in OpenGL axes"),
        (with_centers, "the translations were camera centres"),
        (with_z_up, "x right, y forward and z up"),
    ],
)
def test_each_usual_mix_up_is_found_and_named(
    cameras: torch.Tensor, mix_up: Callable[[torch.Tensor], torch.Tensor], why: str
):
    (note,) = notes(seen_points(cameras), mix_up(cameras))
    assert note.startswith("the given cameras contradict the photos: ")
    assert why in note


def test_cameras_in_another_order_are_told_without_a_guess(cameras: torch.Tensor):
    (note,) = notes(seen_points(cameras), cameras[[3, 0, 4, 1, 2]])
    assert "check which camera belongs to which photo" in note


def test_one_wrong_camera_is_named(cameras: torch.Tensor):
    wrong = cameras.clone()
    # Turned by some 20 pixels and rolled by 0.4, which no depths explain.
    wrong[2] = rigid_from_twist(torch.tensor([0.0, 0, 0, 0.2, 0.2, 0.4])) @ cameras[2]
    (note,) = notes(seen_points(cameras), wrong)
    assert note.startswith("the given cameras of these photos contradict the others: 2.jpg (")


def test_a_mix_up_is_named_even_if_only_one_view_moves(cameras: torch.Tensor):
    # The other views fit either way, and so many of them that the total share looks right.
    moves = torch.zeros(COUNT, 6)
    moves[:, 4] = torch.tensor([0.0, 0.005, 0.01, 0.005, 0.0])
    few = torch.cat([rigid_from_twist(moves[:4]) @ cameras[:1], cameras[1:2]])
    points = seen_points(few)
    assert notes(points, few) == []
    (note,) = notes(points, flipped(few))
    assert note.startswith("the given cameras contradict the photos: 6")
    assert "y and z of the camera axes were reversed (OpenGL" in note


def test_mix_ups_that_explain_as_much_are_all_named(cameras: torch.Tensor):
    # Turns about the y axis, seen from a world that is turned by half a turn about the x axis:
    # b_from_a of the inverse matrices is that of the given ones.
    twists = torch.zeros(COUNT, 6)
    twists[:, 4] = 0.06 * torch.arange(COUNT)
    turned = rigid_from_twist(twists) @ cameras[:1]
    half_turn = torch.diag(torch.tensor([1.0, -1, -1, 1]))
    given = turned @ invert_rigid(cameras[:1]) @ half_turn
    points = seen_points(turned)
    assert notes(points, given) == []
    (note,) = notes(points, flipped(given))
    assert "the matrices were inverted" in note
    assert "or if y and z of the camera axes were reversed" in note


def test_too_few_common_points_are_no_evidence(cameras: torch.Tensor):
    points = seen_points(cameras, share=0.9 * EVIDENCE_SHARE)
    assert notes(points, invert_rigid(cameras)) == []
    assert notes([], cameras) == []


def test_cameras_at_one_place_fit_photos_from_one_place(cameras: torch.Tensor):
    # Where the first one stands, from which the whole cloud is in front of all of them.
    center = invert_rigid(cameras)[0, :3, 3]
    same = rigid(cameras[:, :3, :3], -(cameras[:, :3, :3] @ center))
    assert notes(seen_points(same), same) == []
