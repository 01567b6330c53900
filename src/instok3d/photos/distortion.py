"""Lens distortion by OpenCV's polynomial model, which a pinhole camera leaves out."""

import math
from dataclasses import astuple, dataclass

import torch
from jaxtyping import Float
from torch import Tensor

_SAMPLES = 33


@dataclass(frozen=True)
class Distortion:
    """Coefficients in OpenCV's order; rational, thin prism and tilt terms are not supported."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    def __bool__(self) -> bool:
        return any(astuple(self))

    @property
    def is_finite(self) -> bool:
        """Whether every coefficient is a finite number."""
        return all(map(math.isfinite, astuple(self)))

    @property
    def is_tangential(self) -> bool:
        """Whether it changes when the picture is turned."""
        return bool(self.p1 or self.p2)

    def bend(self, points: Float[Tensor, "*point 2"]) -> Float[Tensor, "*point 2"]:
        """Where the lens puts points of the plane z = 1 in the camera's frame."""
        x, y = points.unbind(-1)
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        return torch.stack(
            [
                x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x),
                y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y,
            ],
            dim=-1,
        )

    def folds(self, points: Float[Tensor, "*point 2"]) -> bool:
        """Whether the lens brings some farther points nearer to the middle, as its model may."""
        r2 = points.square().sum(dim=-1)
        slope = 1 + r2 * (3 * self.k1 + r2 * (5 * self.k2 + r2 * 7 * self.k3))
        return bool((slope <= 0).any())

    def largest_shift(self, intrinsics: Float[Tensor, "3 3"], height: int, width: int) -> float:
        """How far the lens moves any pixel of height x width, in image diagonals.

        Measured on a grid from edge to edge: terms may cancel at the corners alone.
        """
        x = torch.linspace(0, width, _SAMPLES, dtype=intrinsics.dtype)
        y = torch.linspace(0, height, _SAMPLES, dtype=intrinsics.dtype)
        pixels = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)
        focal = intrinsics.diagonal()[:2]
        points = (pixels - intrinsics[:2, 2]) / focal
        shifts = ((self.bend(points) - points) * focal).norm(dim=-1)
        # A NaN that arose from huge coefficients is no small shift either.
        return float(shifts.nan_to_num(nan=math.inf).max()) / math.hypot(width, height)
