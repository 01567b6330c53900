"""Labels lifted onto mask-regularised 3DGS (LUDVIG, Marrie et al., ICCV 2025; PanSt3R).

First Gaussians are optimised on the photos while encodings that are composited likewise must tell
the masks apart, so that no Gaussian reaches across the border of a thing; then they are dropped.
After that each Gaussian takes the mean of the one-hot labels of the pixels, weighted by what it
gives to each: one pass, no optimisation.
"""

from dataclasses import dataclass, field
from time import perf_counter

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.baselines.identity import IdentityEncodings, IdentitySettings
from instok3d.baselines.instances import Instances, instances_of
from instok3d.baselines.seeding import seed_points, seeded_gaussians
from instok3d.baselines.settings import SplatSettings
from instok3d.baselines.splats import fit_gaussians
from instok3d.evaluation.methods import FAR, NEAR, Cost, FittedScene, Need, Shown
from instok3d.refinement.assignment import weights_by_region
from instok3d.types import Cameras, Gaussians

REGULARIZATION = IdentitySettings(weight_2d=0.1, weight_3d=0.0)
"""What the masks weigh while the Gaussians are optimised."""


@dataclass(frozen=True)
class LabelLifting:
    """The method, for masks whose ids hold across views."""

    settings: SplatSettings = field(default_factory=SplatSettings)
    regularization: IdentitySettings = REGULARIZATION
    """weight_2d 0 is plain 3DGS, as LUDVIG takes it."""

    @property
    def needs(self) -> frozenset[Need]:
        """Posed photos with depth and masks."""
        return frozenset({"cameras", "depth", "masks"})

    def fit(self, shown: Shown) -> FittedScene:
        """The scene.

        Raises:
            ValueError: Something is not shown.
        """
        started = perf_counter()
        instances, settings = instances_of(shown), self.settings
        start = seeded_gaussians(
            seed_points(shown, settings.points, seed=settings.seed), sh_degree=settings.sh_degree
        )
        dropped = IdentityEncodings(
            instances, len(start.means), self.regularization, seed=settings.seed
        )
        gaussians = fit_gaussians(start, shown, settings, dropped)
        lifted = lifted_labels(gaussians, shown.cameras, instances)
        count = len(gaussians.means)
        cost = Cost(count, count, count * len(instances.ids), perf_counter() - started)
        return FittedScene(gaussians, lifted, shown.cameras, cost)


def lifted_labels(
    gaussians: Gaussians, cameras: Cameras, instances: Instances
) -> Float[Tensor, "gaussian column"]:
    """Of each Gaussian: the shares of its rendered weight in the pixels of each instance.

    What no view shows is of the void.

    Args:
        gaussians: Each its own anchor.
        cameras: Of the views.
        instances: Of their masks.
    """
    weights = weights_by_region(
        gaussians, instances.columns, instances.num_columns, cameras, near=NEAR, far=FAR
    )
    void = torch.zeros_like(weights)
    void[:, -1] = 1.0
    total = weights.sum(dim=1, keepdim=True)
    return torch.where(total > 0, weights / total.clamp_min(1e-8), void)
