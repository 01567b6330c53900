from pathlib import Path

import pytest
import torch

from instok3d.geometry.cameras import project, transform_points
from instok3d.photos.camera_fit import check_distance, check_distortion, fit_camera, same_shape
from instok3d.photos.cameras import PhotoCamera
from instok3d.photos.distortion import Distortion
from instok3d.photos.pixel_map import fit_pixels, upright_from_stored

PHOTO = Path("photo.jpg")


def camera(height: int, width: int, **more) -> PhotoCamera:
    intrinsics = torch.tensor([[90.0, 0, 0.45 * width], [0, 95, 0.6 * height], [0, 0, 1]]).double()
    cam_from_world = torch.eye(4).double()
    cam_from_world[:3, 3] = torch.tensor([0.1, -0.2, 0.3])
    return PhotoCamera("photo.jpg", height, width, intrinsics, cam_from_world, **more)


def test_a_camera_of_a_smaller_copy_is_scaled_by_hand():
    # Camera of 60 x 80, photo of 120 x 160 that the model sees as it is: everything doubles.
    fitted = fit_camera(camera(60, 80), fit_pixels(120, 160, 120, 160), PHOTO, [])
    expected = torch.tensor([[180.0, 0, 72], [0, 190, 72], [0, 0, 1]]).double()
    torch.testing.assert_close(fitted.intrinsics, expected)


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_a_camera_of_the_stored_photo_turns_with_it(orientation, rng):
    # The same world points must land on the same picture content, however it was turned.
    height, width = 60, 80  # of the stored file
    upright = (width, height) if orientation >= 5 else (height, width)
    pixel_map = fit_pixels(*upright, 32, 40, exif_orientation=orientation)
    notes: list[str] = []
    stored = camera(height, width)
    fitted = fit_camera(stored, pixel_map, PHOTO, notes)
    points = torch.rand(30, 3, generator=rng, dtype=torch.float64) + torch.tensor([0.0, 0, 1])
    pixels = project(transform_points(stored.cam_from_world, points), stored.intrinsics)
    turn = upright_from_stored(orientation, height, width)
    turned = torch.cat([pixels, torch.ones_like(pixels[:, :1])], 1) @ turn.T
    found = project(transform_points(fitted.cam_from_world, points), fitted.intrinsics)
    torch.testing.assert_close(found, pixel_map.to_model(turned[:, :2]))
    assert fitted.turned_by == orientation
    assert fitted.intrinsics[0, 0] > 0
    assert fitted.intrinsics[1, 1] > 0
    torch.testing.assert_close(
        torch.linalg.det(fitted.cam_from_world[:3, :3]), torch.tensor(1.0).double()
    )
    # Upside down keeps the shape, so the file alone does not tell which photo was meant.
    assert bool(notes) == (orientation == 3)


def test_a_camera_of_the_upright_photo_does_not_turn():
    pixel_map = fit_pixels(80, 60, 80, 60, exif_orientation=6)
    fitted = fit_camera(camera(80, 60), pixel_map, PHOTO, [])
    torch.testing.assert_close(fitted.intrinsics, camera(80, 60).intrinsics)
    torch.testing.assert_close(fitted.cam_from_world, camera(80, 60).cam_from_world)
    assert fitted.turned_by == 1


def test_a_mirrored_photo_has_no_camera():
    pixel_map = fit_pixels(60, 80, 60, 80, exif_orientation=2)
    with pytest.raises(ValueError, match="mirrored by its EXIF orientation 2"):
        fit_camera(camera(60, 80), pixel_map, PHOTO, [])


def test_a_camera_of_another_shape_is_an_error():
    with pytest.raises(ValueError, match=r"photo\.jpg is for an image of 80 x 60, .* has 80 x 80"):
        fit_camera(camera(60, 80), fit_pixels(80, 80, 8, 8), PHOTO, [])


def test_shapes_agree_up_to_a_rounded_pixel():
    assert same_shape((375, 500), (3000, 4000))
    assert same_shape((378, 504), (3024, 4032))
    assert same_shape((133, 100), (4000, 3000))  # 133.3 rounded
    assert not same_shape((480, 640), (360, 640))
    assert not same_shape((640, 480), (480, 640))


def test_small_distortion_is_told_and_large_is_refused():
    notes: list[str] = []
    check_distortion([camera(60, 80), camera(60, 80)], notes)
    assert notes == []
    check_distortion([camera(60, 80), camera(60, 80, distortion=Distortion(0.05))], notes)
    assert "lens distortion is ignored" in notes[0]
    with pytest.raises(ValueError, match="undistort the photos first"):
        check_distortion([camera(60, 80, distortion=Distortion(-0.9))], notes)


def _standing_at(x: float) -> PhotoCamera:
    placed = camera(60, 80)
    placed.cam_from_world[:3, 3] = torch.tensor([-x, 0, 0])
    return placed


def test_a_world_whose_origin_is_far_away_is_refused():
    # Two metres apart, 500 km (a map's grid) from the origin: a step there is 6 cm.
    check_distance([_standing_at(0.0), _standing_at(2.0)])
    check_distance([_standing_at(1000.0), _standing_at(1002.0)])
    check_distance([_standing_at(500_000.0)])
    check_distance([_standing_at(1000.0), _standing_at(1000.0 * (1 + 1e-15))])  # rounding alone
    with pytest.raises(ValueError, match=r"stand 5e\+05 units .* move the origin"):
        check_distance([_standing_at(500_000.0), _standing_at(500_002.0)])
