"""PSNR and SSIM of rendered images, each image for itself; LPIPS where its weights are."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

PSNR_MAX = 100.0
"""PSNR of identical images in dB; the mean over images stays finite."""

_SSIM_RADIUS = 5
_SSIM_SIGMA = 1.5
_SSIM_C1 = 0.01**2
_SSIM_C2 = 0.03**2


def psnr(
    images: Float[Tensor, "*batch 3 height width"], targets: Float[Tensor, "*batch 3 height width"]
) -> Float[Tensor, "*batch"]:
    """Peak signal-to-noise ratio in dB of each image, clipped to [0, 1] first, at most 100.

    A mean over images of this value is the per-image figure; pooling the squared errors of all
    images first, as some codes do, gives a lower one.
    """
    error = (images.clamp(0, 1) - targets).square().mean(dim=(-3, -2, -1))
    return -10 * error.clamp_min(10 ** (-PSNR_MAX / 10)).log10()


def ssim(
    images: Float[Tensor, "*batch 3 height width"], targets: Float[Tensor, "*batch 3 height width"]
) -> Float[Tensor, "*batch"]:
    """Structural similarity of each image, clipped to [0, 1] first.

    The definition of scikit-image with gaussian_weights=True and data_range=1: an 11 x 11 window
    of sigma 1.5, sample covariance, the mean over the pixels whose window lies inside the image
    and over the channels.

    Raises:
        ValueError: The images are smaller than the window.
    """
    height, width = images.shape[-2:]
    size = 2 * _SSIM_RADIUS + 1
    if min(height, width) < size:
        raise ValueError(f"ssim needs images of at least {size} x {size}, got {height} x {width}")
    x = images.clamp(0, 1).reshape(-1, 1, height, width).double()
    y = targets.reshape(-1, 1, height, width).double()
    mean_x, mean_y = _window_mean(x), _window_mean(y)
    unbiased = size**2 / (size**2 - 1)
    variance_x = unbiased * (_window_mean(x * x) - mean_x**2)
    variance_y = unbiased * (_window_mean(y * y) - mean_y**2)
    covariance = unbiased * (_window_mean(x * y) - mean_x * mean_y)
    luminance = (2 * mean_x * mean_y + _SSIM_C1) / (mean_x**2 + mean_y**2 + _SSIM_C1)
    structure = (2 * covariance + _SSIM_C2) / (variance_x + variance_y + _SSIM_C2)
    each = (luminance * structure).mean(dim=(-3, -2, -1))
    return each.reshape(*images.shape[:-3], 3).mean(dim=-1).to(images.dtype)


def _window_mean(images: Float[Tensor, "image 1 height width"]) -> Float[Tensor, "image 1 h w"]:
    offsets = torch.arange(-_SSIM_RADIUS, _SSIM_RADIUS + 1, dtype=images.dtype)
    kernel = torch.exp(-0.5 * (offsets / _SSIM_SIGMA) ** 2)
    kernel = (kernel / kernel.sum()).to(images.device)
    rows = functional.conv2d(images, kernel.view(1, 1, -1, 1))
    return functional.conv2d(rows, kernel.view(1, 1, 1, -1))
