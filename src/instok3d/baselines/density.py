"""Gaussians added where the pictures pull at most, and removed where they are not seen (3DGS)."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from instok3d.baselines.settings import DensitySettings
from instok3d.geometry.cameras import transform_points
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.refinement.parameters import GaussianParameters
from instok3d.refinement.splitting import SHRINK
from instok3d.types import Cameras


@dataclass(frozen=True)
class Change:
    """Parameters after Gaussians were added and removed."""

    parameters: GaussianParameters
    source: Int[Tensor, " gaussian"]
    """The row before that each came from."""
    fresh: Bool[Tensor, " gaussian"]
    """Those that were added."""


class DensityControl:
    """Watches gradients, and says at which steps what is added and removed.

    Args:
        settings: When and how much.
        steps: Of the whole optimisation.
        extent: Length of the scene, scene units.
        seed: Of where the halves of a split Gaussian lie.
    """

    def __init__(self, settings: DensitySettings, steps: int, *, extent: float, seed: int) -> None:
        self._settings, self._steps, self._extent = settings, steps, extent
        self._random = torch.Generator().manual_seed(seed)
        self._pull = torch.zeros(0)
        self._views = torch.zeros(0)

    def watch(self, parameters: GaussianParameters, camera: Cameras, width: int) -> None:
        """Take note of the gradients of the centres after one view was looked at.

        The gradient of the projected centre, in halves of the picture's width, follows from that
        of the centre across the line of sight.

        Args:
            parameters: With gradients.
            camera: Of that view.
            width: Of its picture, pixels.
        """
        gradient = parameters.means.grad
        assert gradient is not None
        if len(self._pull) != len(gradient):
            self._pull, self._views = gradient.new_zeros(2, len(gradient)).unbind()
        rotation = camera.cam_from_world[0, :3, :3]
        across = (gradient @ rotation.mT)[:, :2].norm(dim=1)
        depths = transform_points(camera.cam_from_world[0], parameters.means.detach())[:, 2]
        in_picture = across * depths.abs() / camera.intrinsics[0, 0, 0] * (width / 2)
        self._pull = self._pull + in_picture
        self._views = self._views + (in_picture > 0)

    def is_due(self, step: int) -> bool:
        """Whether Gaussians are added and removed after this step."""
        settings, done = self._settings, step + 1
        inside = settings.first * self._steps <= done <= settings.last * self._steps
        return inside and done % settings.every == 0

    def resets(self, step: int) -> bool:
        """Whether opacities are brought down after this step."""
        at = round(self._settings.reset_at * self._steps)
        return at > 0 and step + 1 == at

    @torch.no_grad()
    def reset(self, parameters: GaussianParameters) -> None:
        """Bring all opacities down to at most reset_opacity: what is not seen stays there."""
        most = torch.tensor(self._settings.reset_opacity).logit()
        parameters.opacity_logits.clamp_(max=float(most))

    @torch.no_grad()
    def changed(self, parameters: GaussianParameters, step: int) -> Change:
        """Clone small and split large Gaussians that are pulled, and remove unseen ones."""
        settings = self._settings
        longest = parameters.log_scales.exp().max(dim=1).values
        pull = self._pull / self._views.clamp_min(1)
        kept = parameters.opacity_logits.sigmoid() >= settings.opacity_min
        if settings.reset_at and step + 1 > settings.reset_at * self._steps:
            kept &= longest <= settings.too_large_share * self._extent
        pulled = kept & (pull >= settings.gradient_min)
        room = max(settings.most - int(kept.sum()), 0)
        if int(pulled.sum()) > room:
            pulled = pulled & (pull > pull[pulled].sort(descending=True).values[room])
        split = pulled & (longest > settings.large_share * self._extent)
        repeats = kept.long() + pulled.long()
        source = torch.arange(len(kept)).repeat_interleave(repeats)
        second = torch.zeros_like(source, dtype=torch.bool)
        second[1:] = source[1:] == source[:-1]
        rows = parameters.map(lambda value: value[source].detach().clone())
        self._spread(rows, split[source])
        self._pull, self._views = torch.zeros(0), torch.zeros(0)
        return Change(rows, source, second | split[source])

    def _spread(self, rows: GaussianParameters, halves: Bool[Tensor, " gaussian"]) -> None:
        """Place the halves of split Gaussians at random inside the whole, and make them smaller."""
        scales = rows.log_scales[halves].exp()
        inside = scales * torch.randn(scales.shape, generator=self._random)
        rotations = quat_to_matrix(torch.nn.functional.normalize(rows.quats[halves], dim=-1))
        rows.means[halves] += (rotations @ inside[..., None])[..., 0]
        rows.log_scales[halves] -= torch.tensor(SHRINK).log()
