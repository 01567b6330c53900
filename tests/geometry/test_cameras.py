import math

import torch

from instok3d.geometry.cameras import (
    intrinsics_from_field_of_view,
    invert_rigid,
    pixel_rays,
    project,
    relative_to_first,
    resize_intrinsics,
    rigid,
    transform_points,
    unproject,
)
from instok3d.geometry.registration import rigid_from_twist


def some_transforms(rng: torch.Generator, count: int) -> torch.Tensor:
    return rigid_from_twist(torch.randn(count, 6, generator=rng, dtype=torch.float64))


def test_center_pixel_of_a_three_pixel_image_looks_straight_ahead():
    # Width 3 puts the principal point at 1.5, which is the centre of pixel 1.
    intrinsics = torch.tensor([[2.0, 0, 1.5], [0, 2.0, 1.5], [0, 0, 1]])
    rays = pixel_rays(intrinsics, 3, 3)
    torch.testing.assert_close(rays[1, 1], torch.tensor([0.0, 0.0, 1.0]))
    # Pixel (x=2, y=0) has its centre at (2.5, 0.5): (2.5 - 1.5) / 2 and (0.5 - 1.5) / 2.
    torch.testing.assert_close(rays[0, 2], torch.tensor([0.5, -0.5, 1.0]))


def test_projecting_unprojected_depth_returns_the_pixel_centers(rng):
    intrinsics = torch.tensor([[50.0, 0, 10], [0, 40.0, 6], [0, 0, 1]], dtype=torch.float64)
    depths = torch.rand(12, 20, generator=rng, dtype=torch.float64) + 0.5
    pixels = project(unproject(depths, intrinsics).flatten(0, 1), intrinsics).view(12, 20, 2)
    assert (pixels[3, 7] - torch.tensor([7.5, 3.5])).abs().max() < 1e-12


def test_inverse_transform_undoes_the_transform(rng):
    transforms = some_transforms(rng, 5)
    points = torch.randn(5, 8, 3, generator=rng, dtype=torch.float64)
    back = transform_points(invert_rigid(transforms), transform_points(transforms, points))
    torch.testing.assert_close(back, points)


def test_first_camera_becomes_the_world_and_the_others_keep_their_places(rng):
    cam_from_world = some_transforms(rng, 3)
    relative = relative_to_first(cam_from_world)
    torch.testing.assert_close(relative[0], torch.eye(4, dtype=torch.float64))
    points = torch.randn(4, 3, generator=rng, dtype=torch.float64)
    in_first = transform_points(cam_from_world[0], points)
    torch.testing.assert_close(
        transform_points(relative[2], in_first), transform_points(cam_from_world[2], points)
    )


def test_halving_an_image_halves_focal_length_and_principal_point():
    intrinsics = torch.tensor([[100.0, 0, 64], [0, 90.0, 48], [0, 0, 1]])
    half = resize_intrinsics(intrinsics, scale_x=0.5, scale_y=0.5, offset_x=3.0)
    torch.testing.assert_close(half, torch.tensor([[50.0, 0, 35], [0, 45.0, 24], [0, 0, 1]]))


def test_field_of_view_of_ninety_degrees_is_half_the_width():
    intrinsics = intrinsics_from_field_of_view(torch.tensor(math.pi / 2), 30, 40)
    torch.testing.assert_close(intrinsics, torch.tensor([[20.0, 0, 20], [0, 20.0, 15], [0, 0, 1]]))


def test_rigid_has_a_proper_last_row():
    matrix = rigid(torch.eye(3), torch.tensor([1.0, 2.0, 3.0]))
    torch.testing.assert_close(matrix[3], torch.tensor([0.0, 0.0, 0.0, 1.0]))
    torch.testing.assert_close(matrix[:3, 3], torch.tensor([1.0, 2.0, 3.0]))
