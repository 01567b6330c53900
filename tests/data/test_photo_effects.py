import numpy as np
import pytest
import torch
from scipy.ndimage import map_coordinates

from instok3d.data.photo_effects import (
    jpeg_round_trip,
    line_kernel,
    luma,
    with_contrast,
    with_distortion,
    with_gains,
    with_jpeg,
    with_motion_blur,
    with_noise,
    with_saturation,
    with_vignette,
)


def test_saturation_moves_colours_from_and_to_their_luma():
    red = torch.tensor([1.0, 0.0, 0.0]).view(1, 3, 1, 1)
    torch.testing.assert_close(luma(red), torch.full((1, 1, 1, 1), 0.299))
    torch.testing.assert_close(with_saturation(red, 0.0), torch.full((1, 3, 1, 1), 0.299))
    half = torch.tensor([0.6495, 0.1495, 0.1495]).view(1, 3, 1, 1)
    torch.testing.assert_close(with_saturation(red, 0.5), half)


def test_contrast_and_gains_by_hand():
    photos = torch.full((2, 3, 1, 1), 0.6)
    torch.testing.assert_close(
        with_contrast(photos, 0.5, torch.tensor(0.4)), torch.full((2, 3, 1, 1), 0.5)
    )
    gains = np.array([[1.0, 2.0, 0.5], [1.5, 1.0, 1.0]])
    expected = torch.tensor([[0.6, 1.2, 0.3], [0.9, 0.6, 0.6]])[:, :, None, None]
    torch.testing.assert_close(with_gains(photos, gains), expected)


def test_a_vignette_leaves_the_centre_and_darkens_the_corners_by_the_amount():
    photos = with_vignette(torch.ones(2, 3, 101, 201), np.array([0.0, 0.4]))
    assert torch.equal(photos[0], torch.ones(3, 101, 201))
    assert float(photos[1, 0, 50, 100]) == 1.0
    # The centre of the corner's pixel is within 1 % of the corner.
    assert float(photos[1, 0, 0, 0]) == pytest.approx(0.6, abs=0.01)
    # Halfway to the right border: 50 / half diagonal of (101, 201).
    expected = 1 - 0.4 * 50**2 / ((101**2 + 201**2) / 4)
    assert float(photos[1, 0, 50, 150]) == pytest.approx(expected, abs=1e-6)


def test_distortion_takes_values_from_where_the_formula_says(rng):
    photos = torch.rand(1, 3, 32, 48, generator=rng)
    result = with_distortion(photos, 2.0)  # 0.5 pixels at the corners of a height of 32
    rows, columns = np.mgrid[:32, :48] + 0.5 - np.array([16, 24])[:, None, None]
    half_diagonal = np.hypot(16, 24)
    factor = 1 + 0.5 / half_diagonal * (rows**2 + columns**2) / half_diagonal**2
    places = [rows * factor + 16 - 0.5, columns * factor + 24 - 0.5]
    expected = map_coordinates(photos[0, 0].numpy(), places, order=1, mode="nearest")
    np.testing.assert_allclose(result[0, 0].numpy(), expected, atol=1e-5)
    torch.testing.assert_close(with_distortion(photos, 0.0), photos, atol=1e-5, rtol=0)


def test_line_kernels_by_hand():
    np.testing.assert_array_equal(line_kernel(0.0, 0.3), np.pad([[1.0]], 1))
    across = line_kernel(2.0, 0.0)
    # Points at -1, -3/4, ..., 1: a weight of 1 at both ends and the middle, halves between.
    np.testing.assert_allclose(across[2], np.array([0, 2.5, 4, 2.5, 0]) / 9, atol=1e-6)
    assert across.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(line_kernel(2.0, np.pi / 2), across.T, atol=1e-6)
    diagonal = line_kernel(4.0, np.pi / 4)
    np.testing.assert_allclose(diagonal, diagonal.T, atol=1e-6)
    assert diagonal[4, 4] > diagonal[4, 2] == diagonal[2, 4]


def test_blur_spreads_along_its_line_alone_and_grows_with_the_picture():
    dot = torch.zeros(2, 3, 256, 256)
    dot[..., 128, 128] = 1.0
    blurred = with_motion_blur(dot, np.array([0.0, 2.0]), np.array([0.0, 0.0]))
    torch.testing.assert_close(blurred[0], dot[0])
    assert float(blurred[1].sum()) == pytest.approx(3.0, abs=1e-5)
    lit = blurred[1, 0] > 0
    assert lit.any(dim=1).nonzero().flatten().tolist() == [128]
    assert lit[128].nonzero().flatten().tolist() == [126, 127, 128, 129, 130]


def test_variance_of_the_noise_is_a_line_of_the_value():
    photos = torch.tensor([0.0, 0.5, 1.0]).view(3, 1, 1, 1).expand(3, 3, 100, 100)
    noisy = with_noise(photos, np.full(3, 0.01), np.full(3, 0.03), np.random.default_rng(0))
    expected = torch.tensor([0.01, 0.0005**0.5, 0.03])
    torch.testing.assert_close(noisy.std(dim=(1, 2, 3)), expected, rtol=0.02, atol=0)
    torch.testing.assert_close(noisy.mean(dim=(1, 2, 3)), photos[:, 0, 0, 0], atol=1e-3, rtol=0)


def test_jpeg_of_each_photo_has_its_own_quality(rng):
    # Grey: of colours JPEG halves the size whatever the quality.
    photos = torch.rand(1, 1, 24, 40, generator=rng).expand(2, 3, 24, 40)
    written = with_jpeg(photos, [95, 30])
    errors = (written - photos).abs().mean(dim=(1, 2, 3))
    assert float(errors[1]) > 2 * float(errors[0]) > 0
    picture = (photos[0] * 255).round().byte().permute(1, 2, 0).numpy()
    np.testing.assert_array_equal(
        (written[1] * 255).round().byte().permute(1, 2, 0).numpy(), jpeg_round_trip(picture, 30)
    )


def test_no_photo_is_no_error():
    none = torch.empty(0, 3, 8, 8)
    zero, rng = np.empty(0), np.random.default_rng(0)
    for result in (
        with_saturation(none, 2.0), with_gains(none, np.empty((0, 3))), with_vignette(none, zero),
        with_distortion(none, 1.0), with_motion_blur(none, zero, zero),
        with_noise(none, zero, zero, rng), with_jpeg(none, []),
    ):  # fmt: skip
        assert result.shape == (0, 3, 8, 8)
