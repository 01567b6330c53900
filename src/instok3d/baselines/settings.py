"""How the Gaussians of one scene are optimised, for all methods that do so."""

from dataclasses import dataclass, field

from instok3d.refinement.settings import LearningRates, check_steps


@dataclass(frozen=True)
class DensitySettings:
    """When Gaussians are added and removed, as in 3DGS; steps are shares of all steps."""

    first: float = 0.1
    last: float = 0.5
    """None are added or removed before and after these."""
    every: int = 50
    """Steps between two rounds."""
    gradient_min: float = 2e-4
    """Mean gradient of the projected centre, in halves of the picture's width, from which a
    Gaussian is cloned or split."""
    large_share: float = 0.01
    """Of the extent: a Gaussian with a longer axis is split, another is cloned."""
    opacity_min: float = 0.005
    """Of lower opacity are removed."""
    too_large_share: float = 0.5
    """Of the extent: with a longer axis are removed once opacities were reset."""
    reset_at: float = 0.3
    """When opacities are brought down to reset_opacity; 0 leaves it out."""
    reset_opacity: float = 0.01
    most: int = 60_000
    """Gaussians; none is added beyond it."""


@dataclass(frozen=True)
class SplatSettings:
    """The optimisation of one scene."""

    steps: int = 600
    """Each sees one view."""
    points: int = 16_384
    """Of the depth, at most, from which Gaussians begin."""
    sh_degree: int = 1
    """Of the colours; the bands above the constant are free after half of the steps."""
    ssim_weight: float = 0.2
    """(1 - w) L1 + w (1 - SSIM)."""
    rates: LearningRates = field(
        default_factory=lambda: LearningRates(
            means=1.6e-3,
            log_scales=5e-3,
            quats=1e-3,
            opacity_logits=5e-2,
            sh_constant=2.5e-3,
            sh_others=1.25e-4,
        )
    )
    """Of Adam; that of the means in extents. Those of 3DGS, the means' larger for fewer steps."""
    last_mean_rate: float = 0.01
    """Share of the rate of the means that is left at the end; it falls exponentially."""
    density: DensitySettings | None = field(default_factory=DensitySettings)
    """None keeps the Gaussians that were there at first."""
    seed: int = 0
    """Of the points, the order of the views, and what is random in splits."""

    def __post_init__(self) -> None:
        check_steps(self.steps)
        if self.points < 1:
            raise ValueError(f"points must be at least 1, got {self.points}")
        if not 0 <= self.sh_degree <= 3:
            raise ValueError(f"sh_degree must be in 0..3, got {self.sh_degree}")
        if not 0 <= self.ssim_weight <= 1:
            raise ValueError(f"ssim_weight must be in [0, 1], got {self.ssim_weight}")
