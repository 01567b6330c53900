import numpy as np
import pytest
import torch
from PIL import Image

from instok3d.photos.cropping import crop_about_principal_point, crop_image, crop_values


def pinhole(fx: float, fy: float, cx: float, cy: float) -> torch.Tensor:
    rows = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
    return torch.tensor(rows, dtype=torch.float64)


def test_scannet_by_hand():
    # 640 x 480, K of scene0000's depth: the point (319.6, 242.4) rounds to (320, 242). Margins
    # 320 and 238, so the kept part is 640 x 476 and scale = 256 / 476 = 0.53782.
    # fx' = 577.6 * 0.53782 = 310.64; cx' = 128 + (319.6 - 320) * 0.53782 = 127.785;
    # cy' = 128 + (242.4 - 242) * 0.53782 = 128.215.
    intrinsics = pinhole(577.6, 578.7, 319.6, 242.4)
    pixel_map = crop_about_principal_point(intrinsics, 480, 640, 256, 256)
    left, top, right, bottom = pixel_map.source_box
    assert (left, right) == pytest.approx((82.0, 558.0))
    assert (top, bottom) == pytest.approx((4.0, 480.0))
    cropped = pixel_map.intrinsics_to_model(intrinsics)
    expected = pinhole(310.6420, 311.2336, 127.7849, 128.2151)
    assert torch.allclose(cropped, expected, atol=1e-3)


@pytest.mark.parametrize(("cx", "cy"), [(30.2, 19.8), (33.0, 22.4), (27.6, 17.0)])
@pytest.mark.parametrize(("height", "width"), [(16, 16), (12, 24), (64, 64)])
def test_a_point_keeps_its_colour_depth_and_id_under_the_new_camera(cx, cy, height, width):
    # Red is x, green is y: the colour of a pixel says which pixel of the original it was.
    x, y = np.meshgrid(np.arange(60) + 0.5, np.arange(40) + 0.5)
    image = Image.fromarray(np.stack([4 * x, 4 * y, 0 * x], axis=-1).astype(np.uint8))
    intrinsics = pinhole(50.0, 52.0, cx, cy)
    pixel_map = crop_about_principal_point(intrinsics, 40, 60, height, width)
    cropped = pixel_map.intrinsics_to_model(intrinsics)
    picture = crop_image(image, pixel_map).astype(float)
    ids = crop_values((x.astype(int) + 100 * y.astype(int)).astype(np.uint16), pixel_map)
    assert picture.shape == (height, width, 3)
    inner = slice(3, -3)
    new_x = (np.arange(width) + 0.5 - float(cropped[0, 2])) / float(cropped[0, 0])
    new_y = (np.arange(height) + 0.5 - float(cropped[1, 2])) / float(cropped[1, 1])
    old_x, old_y = new_x * 50.0 + cx, new_y * 52.0 + cy
    assert np.abs(picture[inner, inner, 0] - 4 * old_x[None, inner]).max() < 3
    assert np.abs(picture[inner, inner, 1] - 4 * old_y[inner, None]).max() < 3
    expected = np.floor(old_x)[None] + 100 * np.floor(old_y)[:, None]
    assert (ids == expected).mean() > 0.9  # the rest sits on a border between two pixels
    assert ids.dtype == np.uint16


def test_ids_of_another_resolution_follow():
    pixel_map = crop_about_principal_point(pinhole(50.0, 50.0, 20.0, 10.0), 20, 40, 10, 10)
    small = np.arange(20 * 40).reshape(20, 40)
    large = small.repeat(3, axis=0).repeat(3, axis=1)
    assert np.array_equal(crop_values(large, pixel_map), crop_values(small, pixel_map))


def test_intrinsics_of_another_resolution_are_refused():
    with pytest.raises(ValueError, match="belong to another resolution"):
        crop_about_principal_point(pinhole(500.0, 500.0, 320.0, 240.0), 240, 320, 256, 256)
    with pytest.raises(ValueError, match="at least 1 pixel"):
        crop_about_principal_point(pinhole(5.0, 5.0, 2.0, 2.0), 4, 4, 0, 8)
