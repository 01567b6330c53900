"""Gaussian Grouping (Ye et al., ECCV 2024): an identity encoding for each Gaussian of 3DGS.

Encodings are composited like colours; a linear classifier tells from them which instance a pixel
shows. Neighbours in space are pulled to the same instance.
"""

from dataclasses import dataclass, field, replace
from math import log
from time import perf_counter

import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor
from torch.nn import functional

from instok3d.baselines.density import Change
from instok3d.baselines.instances import Instances, instances_of
from instok3d.baselines.seeding import seed_points, seeded_gaussians
from instok3d.baselines.settings import SplatSettings
from instok3d.baselines.splats import fit_gaussians
from instok3d.evaluation.methods import FAR, NEAR, Cost, FittedScene, Need, Seen, Shown
from instok3d.refinement.adam import Adam
from instok3d.render import render
from instok3d.types import Cameras


@dataclass(frozen=True)
class IdentitySettings:
    """What is learned of instances."""

    channels: int = 16
    """Of an encoding."""
    encoding_rate: float = 5e-3
    classifier_rate: float = 2e-3
    """Of Adam, for some hundred steps; of five times as much encodings learn the faults of each
    view's masks by heart."""
    weight_2d: float = 1.0
    """Of the cross entropy of a picture, over the logarithm of the number of classes."""
    weight_3d: float = 2.0
    """Of the divergence between a Gaussian and its neighbours, over the number of classes."""
    every_3d: int = 5
    """Steps between two looks at neighbours."""
    samples: int = 1000
    neighbors: int = 5
    """Of each sampled Gaussian, itself among them."""


class IdentityEncodings:
    """Encodings and classifier while the Gaussians are optimised; each Gaussian is its own anchor.

    Args:
        instances: Of the shown masks.
        count: Gaussians at first.
        settings: What is learned.
        seed: Of the first values and of the sampled Gaussians.
    """

    def __init__(
        self, instances: Instances, count: int, settings: IdentitySettings, *, seed: int
    ) -> None:
        self.settings = settings
        self._random = torch.Generator().manual_seed(seed)
        self._columns, self._classes = instances.columns, instances.num_columns
        self.encodings = _near_zero(count, settings.channels, self._random).requires_grad_()
        self.weight = _near_zero(self._classes, settings.channels, self._random).requires_grad_()
        self.bias = torch.zeros(self._classes, requires_grad=True)
        rates = (settings.encoding_rate, settings.classifier_rate, settings.classifier_rate)
        values = (self.encodings, self.weight, self.bias)
        self._optimizer = Adam(list(zip(values, rates, strict=True)), eps=1e-15)

    def features(self) -> Float[Tensor, "gaussian channel"]:
        """The encodings."""
        return self.encodings

    def loss(
        self,
        maps: Float[Tensor, "channel height width"],
        view: int,
        step: int,
        means: Float[Tensor, "gaussian 3"],
    ) -> Float[Tensor, ""]:
        """Cross entropy of the classified pixels; with every_3d also that of neighbours."""
        logits = self.classified(maps.permute(1, 2, 0))
        loss = functional.cross_entropy(logits.flatten(0, 1), self._columns[view].flatten())
        loss = self.settings.weight_2d / log(max(self._classes, 2)) * loss
        if self.settings.weight_3d and step % self.settings.every_3d == 0:
            loss = loss + self.settings.weight_3d / self._classes * self._divergence(means)
        return loss

    def classified(self, encodings: Float[Tensor, "*any channel"]) -> Float[Tensor, "*any column"]:
        """Logits of the instances and, last, of none."""
        return encodings @ self.weight.T + self.bias

    def step(self) -> None:
        """One step of Adam along the gradients, which are cleared."""
        self._optimizer.step()

    def follow(self, anchor_index: Int[Tensor, " gaussian"], change: Change) -> Tensor:
        """Added Gaussians have the encoding of the one they came from."""
        del anchor_index
        self.encodings = self.encodings[change.source].detach().clone().requires_grad_()
        self._optimizer.replace(0, self.encodings, change.source, change.fresh)
        return torch.arange(len(change.source))

    def _divergence(self, means: Float[Tensor, "gaussian 3"]) -> Float[Tensor, ""]:
        """Mean Kullback-Leibler divergence of sampled Gaussians from their neighbours."""
        settings = self.settings
        order = torch.randperm(len(means), generator=self._random)[: settings.samples]
        points, count = means.numpy(), min(settings.neighbors, len(means))
        near = KDTree(points).query(points[order.numpy()], k=count)[1].reshape(len(order), count)
        logs = self.classified(self.encodings).log_softmax(dim=1)
        own, others = logs[order][:, None], logs[torch.from_numpy(near)]
        return (own.exp() * (own - others)).sum(dim=2).mean()


@dataclass(frozen=True)
class IdentityScene(FittedScene):
    """A scene whose instances are classified after their encodings were composited."""

    encodings: Float[Tensor, "gaussian channel"] = field(kw_only=True)
    weight: Float[Tensor, "column channel"] = field(kw_only=True)
    bias: Float[Tensor, " column"] = field(kw_only=True)

    def at(self, cameras: Cameras, height: int, width: int) -> Seen:
        """Pictures and masks; the score of an instance is its share of the softmax."""
        rendering = render(
            self.gaussians, cameras, height, width, anchor_features=self.encodings,
            near=NEAR, far=FAR,
        )  # fmt: skip
        assert rendering.features is not None
        maps = torch.einsum("vchw,kc->vkhw", rendering.features, self.weight)
        shares = (maps + self.bias[:, None, None]).softmax(dim=1)
        return Seen(rendering, self.masks_of(shares[:, :-1], rendering.alphas))


@dataclass(frozen=True)
class GaussianGrouping:
    """The method: 3DGS with identity encodings, supervised by masks whose ids hold across views."""

    settings: SplatSettings = field(default_factory=SplatSettings)
    identity: IdentitySettings = field(default_factory=IdentitySettings)

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
        instances = instances_of(shown)
        settings = self.settings
        start = seeded_gaussians(
            seed_points(shown, settings.points, seed=settings.seed), sh_degree=settings.sh_degree
        )
        learned = IdentityEncodings(instances, len(start.means), self.identity, seed=settings.seed)
        gaussians = fit_gaussians(start, shown, settings, learned)
        encodings, weight, bias = (
            value.detach() for value in (learned.encodings, learned.weight, learned.bias)
        )
        count = len(gaussians.means)
        cost = Cost(count, count, encodings.numel() + weight.numel() + bias.numel(), 0.0)
        return IdentityScene(
            gaussians, learned.classified(encodings).detach().softmax(dim=1), shown.cameras,
            replace(cost, fit_s=perf_counter() - started),
            encodings=encodings, weight=weight, bias=bias,
        )  # fmt: skip


def _near_zero(rows: int, columns: int, random: torch.Generator) -> Float[Tensor, "row column"]:
    return torch.randn(rows, columns, generator=random) / columns**0.5
