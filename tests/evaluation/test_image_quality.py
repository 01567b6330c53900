import pytest
import torch

from instok3d.evaluation.image_quality import psnr, ssim


def waves() -> tuple[torch.Tensor, torch.Tensor]:
    y, x = torch.meshgrid(
        torch.arange(24, dtype=torch.float64), torch.arange(20, dtype=torch.float64), indexing="ij"
    )
    first = torch.stack([(x / 3).sin(), (y / 4).cos(), ((x + y) / 5).sin()]) * 0.5 + 0.5
    return first, (first * 0.8 + 0.1 * (x * y / 7).cos() + 0.02).clamp(0, 1)


def test_psnr_of_a_constant_error_by_hand():
    # An error of 0.1 everywhere: MSE 0.01, 10 log10(1 / 0.01) = 20 dB; of 0.5: 6.0206 dB.
    target = torch.full((2, 3, 4, 5), 0.25)
    images = torch.stack([target[0] + 0.1, target[1] + 0.5])
    torch.testing.assert_close(
        psnr(images, target), torch.tensor([20.0, 6.0206]), atol=1e-4, rtol=0
    )


def test_psnr_clips_the_image_before_it_compares():
    # 1.5 shown as 1.0 against 0.9 is an error of 0.1, not 0.6.
    images, target = torch.full((3, 4, 4), 1.5), torch.full((3, 4, 4), 0.9)
    assert float(psnr(images, target)) == pytest.approx(20.0, abs=1e-4)


def test_identical_images_have_finite_psnr_and_ssim_one(rng):
    image = torch.rand(3, 12, 13, generator=rng)
    assert float(psnr(image, image)) == pytest.approx(100.0)
    assert float(ssim(image, image)) == pytest.approx(1.0)


def test_ssim_is_scikit_images():
    # structural_similarity(first, second, win_size=11, gaussian_weights=True, channel_axis=0,
    # data_range=1.0) and peak_signal_noise_ratio of scikit-image 0.26.0 on these two pictures.
    first, second = waves()
    assert float(ssim(second, first)) == pytest.approx(0.7989144475892545, abs=1e-9)
    assert float(psnr(second, first)) == pytest.approx(18.53036485189168, abs=1e-9)


def test_ssim_of_two_constants_by_hand():
    # No variance: only (2 a b + c1) / (a^2 + b^2 + c1) is left, for 0.2 and 0.6:
    # (0.24 + 0.0001) / (0.04 + 0.36 + 0.0001) = 0.60010.
    first, second = torch.full((1, 3, 11, 11), 0.2), torch.full((1, 3, 11, 11), 0.6)
    assert float(ssim(first, second)) == pytest.approx(0.2401 / 0.4001, abs=1e-6)


def test_each_image_of_a_batch_is_measured_alone():
    first, second = waves()
    together = ssim(torch.stack([second, first]), torch.stack([first, first]))
    torch.testing.assert_close(together, torch.stack([ssim(second, first), ssim(first, first)]))


def test_an_image_below_the_window_is_refused():
    with pytest.raises(ValueError, match="at least 11 x 11, got 10 x 30"):
        ssim(torch.zeros(3, 10, 30), torch.zeros(3, 10, 30))
