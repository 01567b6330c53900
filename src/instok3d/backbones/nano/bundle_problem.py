"""What bundle adjustment is given: observations, their expected errors, and what is solved for."""

from dataclasses import dataclass

from jaxtyping import Float, Int
from torch import Tensor

NEAREST = 0.05
"""Least depth of a point in front of a camera, in the network's units."""
CONFIDENCE_MIN = 0.5
"""Matches of lower confidence have no weight."""


@dataclass(frozen=True)
class Observations:
    """Points of one view (here) observed in another (there); a row is an ordered pair of views."""

    scenes: Int[Tensor, " observation"]
    """Index into the batch."""
    here: Int[Tensor, " observation"]
    """The view whose depth gives the points."""
    there: Int[Tensor, " observation"]
    """The view that observes them."""
    points: Float[Tensor, "observation point 3"]
    """In the camera frame of here."""
    rays: Float[Tensor, "observation point 2"]
    """Observed x/z, y/z in the camera frame of there."""
    precision: Float[Tensor, "observation point 2 2"]
    """Inverse covariance of the rays."""
    depths: Float[Tensor, "observation point"]
    """Depth of there at the observed position, > 0."""
    confidence: Float[Tensor, "observation point"]
    """Probability that the match is right."""
    positions_here: Float[Tensor, "observation point 2"]
    """Position of each point in the image of here: x / width, y / height."""
    positions_there: Float[Tensor, "observation point 2"]
    """Position of its match in the image of there: x / width, y / height."""


@dataclass(frozen=True)
class BundleNoise:
    """Expected errors. The defaults were measured on held-out rooms."""

    independence: float = 0.12
    """Effective number of independent matches per match: errors of neighbours correlate."""
    depth: float = 0.14
    """Prior standard deviation of a node's log-depth correction."""
    depth_correlation_length: float = 0.22
    """Of the corrections (exponential covariance), in units of the image's longer side."""
    fine_depth: float = 0.05
    """Standard deviation of the log-depth error that the grid is too coarse to represent."""
    mutual_depth: float = 0.08
    """Standard deviation of the difference between the log depths of a point in two views."""
    focal: float = 0.01
    """Scale of the Cauchy prior on the log focal length: guesses are mostly right, some far off."""
    agreement: float = 0.15
    """Largest error in x/z, y/z at which a match agrees with the initial cameras."""
    outlier: float = 2.0
    """Error in standard deviations at which a residual has half its weight (Cauchy)."""


@dataclass(frozen=True)
class SolveSettings:
    """Which values are solved for, and the expected errors of their initial values."""

    depth_is_free: Float[Tensor, "batch view"]
    """1 where the depth of a view may change, 0 where it is known."""
    focal_is_free: bool = False
    """Whether the focal length, one for all views of a scene, is a guess."""
    noise: BundleNoise = BundleNoise()


def confidence_weight(confidence: Float[Tensor, "*match"]) -> Float[Tensor, "*match"]:
    """Weight of a match: 0 up to CONFIDENCE_MIN, then linear up to 1 at confidence 1."""
    return (confidence - CONFIDENCE_MIN).clamp_min(0) / (1 - CONFIDENCE_MIN)
