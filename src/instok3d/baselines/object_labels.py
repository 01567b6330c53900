"""ObjectGS (Zhu et al., ICCV 2025): anchors whose instance is voted once and then frozen.

One-hot labels of the anchors are composited, so that a Gaussian is of one thing or of none; the
masks move shapes and opacities alone. The Gaussians of an anchor are parameters of their own here,
not the output of Scaffold-GS's networks; added ones belong to the anchor that they came from.
"""

from dataclasses import dataclass, field, replace
from time import perf_counter

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from instok3d.baselines.density import Change
from instok3d.baselines.instances import Instances, instances_of
from instok3d.baselines.seeding import seed_points, seeded_gaussians, voted_labels
from instok3d.baselines.settings import SplatSettings
from instok3d.baselines.splats import fit_gaussians
from instok3d.evaluation.methods import Cost, FittedScene, Need, Shown


@dataclass(frozen=True)
class LabelSettings:
    """How labels are placed, and what they weigh."""

    voxel: float = 0.02
    """Edge of the cells in which points of one label share an anchor, of the median depth."""
    weight: float = 0.1
    """Of the cross entropy of the composited labels."""


class FrozenLabels:
    """One-hot labels of anchors while the Gaussians are optimised.

    Args:
        labels: Column of each anchor.
        instances: Of the shown masks.
        weight: Of the cross entropy.
    """

    def __init__(self, labels: Int[Tensor, " anchor"], instances: Instances, weight: float) -> None:
        self._columns, self._weight = instances.columns, weight
        self._void = len(instances.ids)
        self.one_hot = functional.one_hot(labels, instances.num_columns).float()

    def features(self) -> Float[Tensor, "anchor column"]:
        """The labels; they have no gradient."""
        return self.one_hot

    def loss(
        self,
        maps: Float[Tensor, "column height width"],
        view: int,
        step: int,
        means: Float[Tensor, "gaussian 3"],
    ) -> Float[Tensor, ""]:
        """Cross entropy with the composited labels as logits; pixels of no thing do not count."""
        del step, means
        truth = self._columns[view].flatten()
        if not (truth != self._void).any():
            return maps.new_zeros(())
        logits = maps.flatten(1).T
        return self._weight * functional.cross_entropy(logits, truth, ignore_index=self._void)

    def step(self) -> None:
        """Nothing here is learned."""

    def follow(self, anchor_index: Int[Tensor, " gaussian"], change: Change) -> Tensor:
        """Added Gaussians belong to the anchor of the one they came from."""
        return anchor_index[change.source]


@dataclass(frozen=True)
class ObjectGs:
    """The method: anchors with frozen labels, supervised by masks whose ids hold across views."""

    settings: SplatSettings = field(default_factory=SplatSettings)
    labels: LabelSettings = field(default_factory=LabelSettings)

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
        points = seed_points(shown, settings.points, seed=settings.seed)
        columns = instances.column_of(voted_labels(points.positions, shown))
        depths = shown.views.depths
        assert depths is not None
        edge = self.labels.voxel * float(depths[depths > 0].median())
        anchors, labels = anchors_of(points.positions, columns, edge)
        start = seeded_gaussians(points, sh_degree=settings.sh_degree)
        frozen = FrozenLabels(labels, instances, self.labels.weight)
        gaussians = fit_gaussians(replace(start, anchor_index=anchors), shown, settings, frozen)
        cost = Cost(len(gaussians.means), len(labels), len(labels), perf_counter() - started)
        return FittedScene(gaussians, frozen.one_hot, shown.cameras, cost)


def anchors_of(
    positions: Float[Tensor, "point 3"], labels: Int[Tensor, " point"], edge: float
) -> tuple[Int[Tensor, " point"], Int[Tensor, " anchor"]]:
    """Points of one label in one cell of a grid share an anchor.

    Args:
        positions: Scene units.
        labels: Of the points.
        edge: Of a cell, scene units.

    Returns:
        The anchor of each point, and the label of each anchor.
    """
    cells = torch.cat([(positions / edge).floor().long(), labels[:, None]], dim=1)
    unique, anchors = cells.unique(dim=0, return_inverse=True)
    return anchors, unique[:, 3]
