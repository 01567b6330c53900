"""Dense depth that agrees with a few known points."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.cameras import pixel_centers

LEAST_POINTS = 20
"""Of a view with fewer known points depth keeps its shape, at the scale of the other views."""
DEVIATION = 0.3
"""Expected error of log depth after the scale of a view is right."""
CORRELATION_LENGTH = 0.2
"""Of that error (exponential covariance), in units of the longer side of the image."""
POINT_DEVIATION = 0.05
"""Expected error of the log depth of a known point."""
OUTLIER = 0.15
"""Difference of log depth at which a point has half its weight (Cauchy)."""
ITERATIONS = 5


@dataclass(frozen=True)
class KnownPoints:
    """Points of one view whose depth is known."""

    pixels: Float[Tensor, "point 2"]
    """In the image of the view; those outside of it are not used."""
    depths: Float[Tensor, " point"]
    """Above 0."""

    def inside(self, height: int, width: int) -> "KnownPoints":
        """Those that lie in the image."""
        limit = self.pixels.new_tensor([width, height])
        rows = ((self.pixels >= 0) & (self.pixels < limit)).all(dim=1)
        return KnownPoints(self.pixels[rows], self.depths[rows])


def fit_depth(
    depths: Float[Tensor, "view height width"], known: list[KnownPoints]
) -> Float[Tensor, "view height width"]:
    """Dense depth in the unit of the known points, corrected smoothly towards them.

    1. The median ratio of known to dense depth gives the scale of each view.
    2. What is left in log depth is interpolated from the points by Gaussian-process regression,
       robustly; far from all points the correction is the scale alone.

    Args:
        depths: Above 0; any unit.
        known: Of each view.

    Raises:
        ValueError: No view has LEAST_POINTS points inside of its image.
    """
    height, width = depths.shape[-2:]
    points = [each.inside(height, width) for each in known]
    ratios = []
    for view, each in enumerate(points):
        x, y = each.pixels.long().T
        ratios.append((each.depths / depths[view, y, x]).log())
    enough = [ratio for ratio in ratios if len(ratio) >= LEAST_POINTS]
    if not enough:
        raise ValueError(
            f"no photo shows {LEAST_POINTS} points whose depth is known: take more photos of the "
            "same things, or --geometry nano"
        )
    typical = torch.cat(enough).median()
    corrections = []
    for each, ratio in zip(points, ratios, strict=True):
        if len(ratio) < LEAST_POINTS:
            corrections.append(typical.expand(height, width))
        else:
            scale = ratio.median()
            corrections.append(scale + _interpolated(each.pixels, ratio - scale, height, width))
    return depths * torch.stack(corrections).exp()


def _interpolated(
    places: Float[Tensor, "point 2"], values: Float[Tensor, " point"], height: int, width: int
) -> Float[Tensor, "{height} {width}"]:
    """Values at every pixel from those at places, near 0 far from all of them."""
    unit = CORRELATION_LENGTH * max(height, width)
    places, values = places.double(), values.double()

    def covariance(pixels: Tensor) -> Tensor:
        return DEVIATION**2 * torch.exp(-torch.cdist(pixels, places) / unit)

    between = covariance(places)
    weights, factors = torch.ones_like(values), values
    for _ in range(ITERATIONS):
        inverse = torch.linalg.inv(between + torch.diag(POINT_DEVIATION**2 / weights))
        factors = inverse @ values
        # What the other points say of each: a wrong point would explain itself.
        left_out = factors / inverse.diagonal()
        weights = 1 / (1 + (left_out / OUTLIER) ** 2)
    everywhere = pixel_centers(height, width, like=places).flatten(0, 1)
    return (covariance(everywhere) @ factors).view(height, width).float()
