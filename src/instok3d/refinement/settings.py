"""How Gaussians are optimised on photos."""

from dataclasses import dataclass, field
from math import isfinite

DEFAULT_STEPS = 100
"""More give little on photos that were not shown: docs/log.md (2026-11-28) has the curve."""
MAX_STEPS = 100_000


@dataclass(frozen=True)
class LearningRates:
    """Of Adam, for each kind of parameter."""

    means: float = 6e-4
    """In typical distances from the cameras."""
    log_scales: float = 1e-2
    quats: float = 4e-3
    opacity_logits: float = 4e-2
    sh_constant: float = 1e-2
    sh_others: float = 1e-3
    exposure: float = 1e-2
    """Logarithms of the gains, and the offsets."""


@dataclass(frozen=True)
class RefinementSettings:
    """How long, and with what."""

    steps: int = DEFAULT_STEPS
    views_per_step: int = 3
    """Of more views, this many are drawn for each step; all have had their turn before one has
    its second."""
    coarse_share: float = 0.4
    """Share of the steps that see the photos at less than full size."""
    coarse_side: int = 64
    """Photos are halved at most until their longer side is below twice this."""
    mean_pull: float = 1.0
    """Weight of the mean squared distance of the centres from where they began, in typical
    distances: keeps Gaussians at their object."""
    exposure: bool = True
    """Fit three gains and three offsets to each photo, whose means over the photos are held."""
    split_share: float = 0.0
    """Share of the Gaussians, those with the largest gradients, that are split in two half-way;
    0 keeps the number and order of the Gaussians."""
    seed: int = 0
    """Of the order of the views."""
    rates: LearningRates = field(default_factory=LearningRates)

    def __post_init__(self) -> None:
        check_steps(self.steps)
        if self.views_per_step < 1 or self.coarse_side < 1:
            raise ValueError(
                "views_per_step and coarse_side must be at least 1, got "
                f"{self.views_per_step} and {self.coarse_side}"
            )
        if not 0 <= self.coarse_share <= 1 or not 0 <= self.split_share <= 1:
            raise ValueError(
                "coarse_share and split_share must lie in [0, 1], got "
                f"{self.coarse_share} and {self.split_share}"
            )
        if not (isfinite(self.mean_pull) and self.mean_pull >= 0):
            raise ValueError(f"mean_pull must be 0 or more, got {self.mean_pull}")


def check_steps(steps: int) -> None:
    """Refuse a number of steps that cannot be done.

    Raises:
        ValueError: Below 0 or above MAX_STEPS.
    """
    if not 0 <= steps <= MAX_STEPS:
        raise ValueError(
            f"steps of refinement must lie in 0..{MAX_STEPS}, got {steps}; 0 leaves the scene as "
            "it is"
        )
