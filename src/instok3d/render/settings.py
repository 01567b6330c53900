"""The numbers that decide which Gaussians touch a pixel."""

from dataclasses import dataclass


@dataclass(frozen=True)
class RasterSettings:
    """Thresholds of the rasterizer; the defaults are those of gsplat's CUDA kernels.

    With alpha_min and transmittance_min at 0 a rendering is a smooth function of its inputs
    (reference backend only), as a numerical gradient check needs it.
    """

    eps2d: float = 0.3
    """Added to the diagonal of every projected covariance, square pixels: no Gaussian is
    narrower than about half a pixel."""
    alpha_min: float = 1 / 255
    """A Gaussian is skipped in a pixel where its alpha is below this."""
    alpha_max: float = 0.99
    """Alphas are cut to this, and then have no gradient to shape and opacity."""
    transmittance_min: float = 1e-4
    """A pixel ends before the Gaussian that would bring its transmittance to this or below."""

    def __post_init__(self) -> None:
        if not 0 <= self.alpha_min < self.alpha_max < 1:
            raise ValueError(
                "alpha_min and alpha_max must satisfy 0 <= alpha_min < alpha_max < 1, got "
                f"alpha_min={self.alpha_min}, alpha_max={self.alpha_max}"
            )
        if not 0 <= self.transmittance_min < 1 or not self.eps2d >= 0:
            raise ValueError(
                "transmittance_min must lie in [0, 1) and eps2d must not be negative, got "
                f"transmittance_min={self.transmittance_min}, eps2d={self.eps2d}"
            )
