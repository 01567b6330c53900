import numpy as np
import pytest
import torch
from PIL import Image, ImageOps

from instok3d.geometry.cameras import project
from instok3d.photos.pixel_map import fit_pixels, upright_from_stored


def test_crop_of_a_landscape_photo_by_hand():
    # 480 x 640 into 120 x 120: scale 120 / 480 = 1/4, width 160, so 20 pixels go on each side.
    pixel_map = fit_pixels(480, 640, 120, 120)
    assert (pixel_map.scale_x, pixel_map.scale_y) == (0.25, 0.25)
    assert (pixel_map.offset_x, pixel_map.offset_y) == (-20.0, 0.0)
    assert pixel_map.source_box == (80.0, 0.0, 560.0, 480.0)
    assert pixel_map.seen_share == 0.75
    points = torch.tensor([[80.0, 0.0], [320.0, 240.0], [82.0, 2.0]])
    expected = torch.tensor([[0.0, 0.0], [60.0, 60.0], [0.5, 0.5]])
    torch.testing.assert_close(pixel_map.to_model(points), expected)
    torch.testing.assert_close(pixel_map.to_original(expected), points)


def test_letterbox_of_a_portrait_photo_by_hand():
    # 640 x 420 into 128 x 128: factor 1/5, so 128 x 84, bars of 22 pixels left and right.
    pixel_map = fit_pixels(640, 420, 128, 128, fit="letterbox")
    assert (pixel_map.scale_x, pixel_map.scale_y) == (0.2, 0.2)
    assert (pixel_map.offset_x, pixel_map.offset_y) == (22.0, 0.0)
    assert pixel_map.source_box == pytest.approx((0.0, 0.0, 420.0, 640.0))
    assert pixel_map.seen_share == pytest.approx(1.0)


def test_letterbox_scales_each_axis_by_its_own_exact_factor():
    # 378 x 506 into 128: 128 / 506 x 378 = 95.6, rounded to 96 rows.
    pixel_map = fit_pixels(378, 506, 128, 128, fit="letterbox")
    assert (pixel_map.scale_x, pixel_map.scale_y) == (128 / 506, 96 / 378)


def test_intrinsics_follow_the_half_pixel_rule_by_hand():
    # Scale 1/4 and 20 pixels cut on the left: cx = 320 / 4 - 20 = 60, cy = 242 / 4 = 60.5.
    pixel_map = fit_pixels(480, 640, 120, 120)
    original = torch.tensor([[500.0, 0.0, 320.0], [0.0, 504.0, 242.0], [0.0, 0.0, 1.0]])
    expected = torch.tensor([[125.0, 0.0, 60.0], [0.0, 126.0, 60.5], [0.0, 0.0, 1.0]])
    torch.testing.assert_close(pixel_map.intrinsics_to_model(original), expected)
    torch.testing.assert_close(pixel_map.intrinsics_to_original(expected), original)


@pytest.mark.parametrize("fit", ["crop", "letterbox"])
@pytest.mark.parametrize("size", [(378, 506), (1113, 739), (1, 1), (50, 3000)])
def test_projecting_and_fitting_commute(size, fit, rng):
    pixel_map = fit_pixels(*size, 128, 96, fit=fit)
    intrinsics = torch.tensor(
        [[400.0, 0.0, 0.4 * size[1]], [0.0, 410.0, 0.6 * size[0]], [0.0, 0.0, 1.0]]
    ).double()
    points = torch.rand(20, 3, generator=rng, dtype=torch.float64) + 0.5
    pixels = project(points, intrinsics)
    fitted = project(points, pixel_map.intrinsics_to_model(intrinsics))
    torch.testing.assert_close(pixel_map.to_model(pixels), fitted)
    torch.testing.assert_close(pixel_map.to_original(fitted), pixels)


def test_a_resized_map_shows_the_same_part_of_the_photo():
    for fit in ("crop", "letterbox"):
        own = fit_pixels(480, 640, 128, 128, fit=fit, exif_orientation=6)
        larger = own.resized(504, 256)
        assert (larger.height, larger.width, larger.exif_orientation) == (504, 256, 6)
        assert larger.source_box == pytest.approx(own.source_box)
        points = torch.tensor([[100.0, 30.0], [320.5, 240.5]])
        expected = own.to_model(points) * torch.tensor([2.0, 504 / 128])
        torch.testing.assert_close(larger.to_model(points), expected)
        assert larger.resized(128, 128).source_box == pytest.approx(own.source_box)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_upright_pixels_are_where_pillow_puts_them(orientation):
    # Every stored pixel carries its own number; its centre must land on the same number.
    stored = np.arange(15, dtype=np.uint8).reshape(3, 5)
    image = Image.fromarray(stored)
    image.getexif()[0x0112] = orientation
    upright = np.asarray(ImageOps.exif_transpose(image))
    matrix = upright_from_stored(orientation, 3, 5)
    for row in range(3):
        for column in range(5):
            x, y, _ = (matrix @ torch.tensor([column + 0.5, row + 0.5, 1.0]).double()).tolist()
            assert upright[int(y), int(x)] == stored[row, column]


def test_a_photo_without_pixels_is_an_error():
    with pytest.raises(ValueError, match="at least 1 pixel"):
        fit_pixels(0, 10, 8, 8)
