"""Per-scene 3DGS: the Gaussians of one scene optimised on its photos from given cameras."""

from dataclasses import dataclass, field
from time import perf_counter
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.baselines.density import Change, DensityControl
from instok3d.baselines.seeding import seed_points, seeded_gaussians
from instok3d.baselines.settings import SplatSettings
from instok3d.evaluation.image_quality import ssim
from instok3d.evaluation.methods import FAR, NEAR, Cost, FittedScene, Need, Shown
from instok3d.geometry.cameras import invert_rigid
from instok3d.refinement.parameters import GaussianParameters
from instok3d.refinement.supervision import turns
from instok3d.render import render
from instok3d.types import Cameras, Gaussians

MEANS, SH_OTHERS = 0, 5
"""Places of fields among those of `GaussianParameters`."""


@runtime_checkable
class Supervision2D(Protocol):
    """What is learned of instances beside the colours, from maps that are composited likewise."""

    def features(self) -> Float[Tensor, "anchor channel"]:
        """That are composited, by anchor."""
        ...

    def loss(
        self,
        maps: Float[Tensor, "channel height width"],
        view: int,
        step: int,
        means: Float[Tensor, "gaussian 3"],
    ) -> Float[Tensor, ""]:
        """What is added to the loss of the colours of this view; the centres are detached."""
        ...

    def step(self) -> None:
        """One step along the gradients, which are cleared."""
        ...

    def follow(
        self, anchor_index: Int[Tensor, " gaussian"], change: Change
    ) -> Int[Tensor, " gaussian"]:
        """The anchors of the Gaussians after a change, of those before."""
        ...


@dataclass(frozen=True)
class SplatMethod:
    """Plain 3DGS: pictures alone, no instances."""

    settings: SplatSettings = field(default_factory=SplatSettings)

    @property
    def needs(self) -> frozenset[Need]:
        """Posed photos with depth."""
        return frozenset({"cameras", "depth"})

    def fit(self, shown: Shown) -> FittedScene:
        """The scene."""
        started = perf_counter()
        points = seed_points(shown, self.settings.points, seed=self.settings.seed)
        start = seeded_gaussians(points, sh_degree=self.settings.sh_degree)
        gaussians = fit_gaussians(start, shown, self.settings)
        cost = Cost(len(gaussians.means), 0, 0, perf_counter() - started)
        return FittedScene(gaussians, None, shown.cameras, cost)


@torch.enable_grad()
def fit_gaussians(
    start: Gaussians,
    shown: Shown,
    settings: SplatSettings,
    supervision: Supervision2D | None = None,
) -> Gaussians:
    """Optimise Gaussians on the shown photos. Not differentiable.

    Adam, one view a step, all views before one has its second turn; (1 - w) L1 + w (1 - SSIM);
    Gaussians are cloned, split and removed, and opacities reset, by `settings.density`. Same
    input, seed and number of threads give the same bits.

    Args:
        start: Where they begin, unbatched.
        shown: With cameras.
        settings: How long, and with what.
        supervision: Of instances.

    Raises:
        ValueError: No Gaussian is left.
    """
    fit = _Fit(start, shown, settings, supervision)
    turn = turns(len(fit.photos), 1, seed=settings.seed)
    for step in range(settings.steps):
        (view,) = next(turn)
        fit.look_at(view, step)
        fit.change_density(step)
    return fit.gaussians().map(Tensor.detach)


class _Fit:
    """The optimisation of one scene; see `fit_gaussians`."""

    def __init__(
        self,
        start: Gaussians,
        shown: Shown,
        settings: SplatSettings,
        supervision: Supervision2D | None,
    ) -> None:
        self.cameras, self.photos = shown.cameras, shown.views.images[0]
        self._settings, self._supervision = settings, supervision
        self._extent = scene_extent(self.cameras)
        self._parameters, self._anchors = GaussianParameters.of(start), start.anchor_index
        self._optimizer = self._parameters.optimizer(settings.rates, length=self._extent)
        self._density = settings.density and DensityControl(
            settings.density, settings.steps, extent=self._extent, seed=settings.seed
        )

    def gaussians(self) -> Gaussians:
        """As they are now, differentiable in the parameters."""
        return self._parameters.gaussians(self._anchors)

    def look_at(self, view: int, step: int) -> None:
        """One step of Adam on one view."""
        rates, done = self._settings.rates, step / self._settings.steps
        falling = self._settings.last_mean_rate**done
        self._optimizer.set_rate(MEANS, rates.means * self._extent * falling)
        self._optimizer.set_rate(SH_OTHERS, rates.sh_others * (done >= 0.5))
        camera, supervision = self.cameras.view(view), self._supervision
        gaussians, photo = self.gaussians(), self.photos[view : view + 1]
        features = None if supervision is None else supervision.features()
        rendering = render(
            gaussians, camera, *photo.shape[-2:], anchor_features=features, near=NEAR, far=FAR
        )
        loss = photometric_loss(rendering.colors, photo, self._settings.ssim_weight)
        if supervision is not None:
            assert rendering.features is not None
            means = gaussians.means.detach()
            loss = loss + supervision.loss(rendering.features[0], view, step, means)
        loss.backward()
        if self._density:
            self._density.watch(self._parameters, camera, photo.shape[-1])
        self._optimizer.step()
        if supervision is not None:
            supervision.step()

    def change_density(self, step: int) -> None:
        """Add and remove Gaussians, and reset opacities, where it is time after this step."""
        density = self._density
        if density and density.is_due(step):
            change = density.changed(self._parameters, step)
            if not len(change.source):
                raise ValueError("every Gaussian was removed: the photos do not fit the cameras")
            self._parameters = change.parameters.map(Tensor.requires_grad_)
            for place, value in enumerate(vars(self._parameters).values()):
                self._optimizer.replace(place, value, change.source, change.fresh)
            if self._supervision is None:
                self._anchors = self._anchors[change.source]
            else:
                self._anchors = self._supervision.follow(self._anchors, change)
        if density and density.resets(step):
            density.reset(self._parameters)


def photometric_loss(
    renders: Float[Tensor, "view 3 height width"],
    photos: Float[Tensor, "view 3 height width"],
    ssim_weight: float,
) -> Float[Tensor, ""]:
    """(1 - w) L1 + w (1 - SSIM), the mean over views."""
    absolute = (renders - photos).abs().mean()
    if ssim_weight == 0:
        return absolute
    return (1 - ssim_weight) * absolute + ssim_weight * (1 - ssim(renders, photos).mean())


def scene_extent(cameras: Cameras) -> float:
    """1.1 times the largest distance of a camera from the mean of all, as in 3DGS; 1 where it is 0.

    Scene units.
    """
    centers = invert_rigid(cameras.cam_from_world)[:, :3, 3]
    return 1.1 * float((centers - centers.mean(dim=0)).norm(dim=1).max()) or 1.0
