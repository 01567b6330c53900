"""Stage "adapt": a backbone learns the unit and the frame of the cameras it is to serve (Sec. 4).

A pretrained geometry model answers in units of its own. One Gaussian stands on each point of its
pointmaps; rendered at true cameras, they must show the photos, so the pointmaps have to come into
the cameras' units. The Gaussians are thrown away afterwards, the backbone goes on.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from PIL.Image import Image
from torch import Tensor, nn

from instok3d.backbones.base import BackboneConfig
from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.backbones.registry import build_backbone
from instok3d.data.sample import Sample, photos_only
from instok3d.evaluation.geometry_errors import depth_errors
from instok3d.evaluation.image_quality import psnr
from instok3d.geometry.camera_alignment import TargetCameras
from instok3d.model.pixel_gaussians import PixelGaussianConfig, PixelGaussians, PixelScene
from instok3d.objectives.rendering import rendering_loss
from instok3d.pictures import color_picture, contact_sheet, depth_picture, titled_rows
from instok3d.render import render
from instok3d.training.backbone_file import save_backbone
from instok3d.training.cache.features import of_backbone
from instok3d.training.first_weights import load_backbone
from instok3d.training.perceptual import lpips_needed, lpips_network
from instok3d.training.stages.answers import (
    AveragedRun,
    DataNeeds,
    FirstWeights,
    NeededWeights,
    Workload,
)
from instok3d.training.stages.stage import StageConfig, StepLoss
from instok3d.training.stages.target_cameras import (
    ScaleFrom,
    cameras_of_targets,
    need_depths,
)
from instok3d.types import Rendering


@dataclass(frozen=True)
class AdaptStageConfig(StageConfig):
    """What the adapt stage trains. The paper says "a few epochs" and no more (Sec. 4)."""

    backbone: BackboneConfig = field(default_factory=NanoConfig)
    weights: str | None = None
    """First weights of the backbone by their name in the catalogue (`instok3d models list`), where
    the run is not given any; None = it must be."""
    trained: tuple[str, ...] = ()
    """Parts of the backbone that learn, by their names in it; empty = all. Parts on which no
    pointmap depends get no gradient and are best left out."""
    head: PixelGaussianConfig = field(default_factory=PixelGaussianConfig)
    intrinsics_probability: float = 1.0
    """Share of the steps in which the backbone gets the intrinsics; in the paper always."""
    target_cameras: TargetCameras = "true"
    """true: pointmaps must come into the unit of the true cameras, which is what the stage is for.
    aligned: cameras are brought into the predicted world instead."""
    scale_from: ScaleFrom = "baselines"
    """With aligned cameras: how they find their length in the predicted world."""
    lpips_weight: float = 0.05
    """As in the paper's render loss."""
    lpips_file: Path | None = None
    """Weights of LPIPS as safetensors; None = those of the catalogue."""
    lpips_name: str = "lpips-vgg16"
    """In the catalogue."""

    def __post_init__(self):
        object.__setattr__(self, "trained", tuple(self.trained))

    def build(self) -> "AdaptStage":
        """The stage of these settings."""
        return AdaptStage(self)

    def new_model(self) -> PixelGaussians:
        """See `new_adapt_model`."""
        return new_adapt_model(self)

    def workload(self) -> Workload:
        """The whole backbone counts as learning; the head works by the pixel."""
        return Workload(backbone=self.backbone, lpips=self.lpips_weight > 0, pixel_parts=("head",))

    def data_needs(self) -> DataNeeds:
        """Depth where it fixes the length of aligned cameras."""
        return DataNeeds(depths=need_depths(self.target_cameras, self.scale_from))

    def first_weights(self) -> FirstWeights:
        """The published ones of the settings, or the user's."""
        return FirstWeights(self.weights, "a trained backbone")

    def learns_unit(self) -> bool:
        """Where targets are rendered at the true cameras."""
        return self.target_cameras == "true"

    def other_weights(self) -> tuple[NeededWeights, ...]:
        """Those of LPIPS."""
        return lpips_needed(self)

    def export(self, run: AveragedRun, output: Path, *, half: bool) -> None:
        """Write the backbone without the head, which has done its work; `--init-from` takes it."""
        weights = of_backbone(run.weights)
        save_backbone(self.backbone, weights, output, card=run.card, half=half)


def new_adapt_model(config: AdaptStageConfig) -> PixelGaussians:
    """Backbone and head with random weights; what is not to learn requires no gradient.

    Raises:
        ValueError: A part that is to learn is not in the backbone.
    """
    model = PixelGaussians(build_backbone(config.backbone), config.head)
    if not config.trained:
        return model
    names = [name for name, _ in model.backbone.named_parameters()]
    for part in config.trained:
        if not any(_belongs(name, part) for name in names):
            raise ValueError(
                f"stage.trained names {part!r}, which {type(model.backbone).__name__} does not have"
            )
    for name, parameter in model.backbone.named_parameters():
        learns = any(_belongs(name, part) for part in config.trained)
        parameter.requires_grad_(learns and parameter.requires_grad)
    return model


def _belongs(name: str, part: str) -> bool:
    return f".{part}." in f".{name}."


class AdaptStage:
    """Rendering loss of one Gaussian a pixel at the target views."""

    def __init__(self, config: AdaptStageConfig) -> None:
        self.config = config
        self.lpips = lpips_network(config)

    @property
    def learns_whole(self) -> bool:
        """No: the parts that are to learn may have some on which no pointmap depends."""
        return False

    def build_model(self) -> PixelGaussians:
        """A new backbone with a new head."""
        return new_adapt_model(self.config)

    def load_initial(self, model: nn.Module, weights: Mapping[str, Tensor]) -> None:
        """All weights of an adapt run, else the backbone's of another run or a file."""
        assert isinstance(model, PixelGaussians)
        if any(name.startswith("head.enlarge.") for name in weights):
            model.load_state_dict(dict(weights))
        else:
            load_backbone(model.backbone, weights)

    def loss(self, model: nn.Module, sample: Sample, step: int) -> StepLoss:
        """MSE + LPIPS at the target views, which with two contexts are these and a new one."""
        config = self.config
        with_intrinsics = bool(
            np.random.default_rng([5, step]).random() < config.intrinsics_probability
        )
        _, rendering = self._run(model, sample, with_intrinsics=with_intrinsics)
        images = sample.target.images
        lpips = self.lpips.to(images.device) if self.lpips else None
        loss = rendering_loss(
            rendering.colors, images, lpips=lpips, lpips_weight=config.lpips_weight
        )
        terms = {"mse": loss.mse, "alpha": rendering.alphas.mean()}
        if config.lpips_weight:
            terms["lpips"] = loss.lpips
        return StepLoss(loss.total, {name: value.detach() for name, value in terms.items()})

    def validate(self, model: nn.Module, samples: Sequence[Sample]) -> dict[str, float]:
        """PSNR; with true depth also the pointmaps' unit (1 is right) and error after scaling."""
        quality, units, errors = [], [], []
        for sample in samples:
            scene, rendering = self._run(
                model, sample, with_intrinsics=self.config.intrinsics_probability > 0
            )
            quality.append(psnr(rendering.colors, sample.target.images).flatten())
            depths = sample.context.depths
            for k, points in enumerate(scene.geometry.pointmaps[:, 0].float()):
                if depths is None or not (depths[k, 0] > 0).any():
                    continue
                found = depth_errors(points[..., 2].clamp_min(1e-3)[None], depths[k, :1])
                units.append(1 / found.scale)
                errors.append(found.scaled)
        figures = {"psnr": float(torch.cat(quality).mean())}
        if units:
            figures["unit"] = float(np.median(units))
            figures["depth_rel"] = float(np.mean(errors))
        return figures

    def pictures(self, model: nn.Module, sample: Sample) -> Image:
        """First and last context, a target, its render, and depth of the pointmap and render."""
        scene, rendering = self._run(
            model, sample, with_intrinsics=self.config.intrinsics_probability > 0
        )
        rows = []
        for k in range(len(sample.names)):
            own = scene.geometry.pointmaps[k, 0, ..., 2].float()
            farthest = float(own.max().clamp_min(1e-3))
            rows.append(
                [
                    *(color_picture(sample.context.images[k, v]) for v in (0, -1)),
                    color_picture(sample.target.images[k, 0]),
                    color_picture(rendering.colors[k, 0]),
                    depth_picture(own, farthest=farthest),
                    depth_picture(rendering.depths[k, 0], farthest=farthest),
                ]
            )
        titles = ["first", "last", "target", "render", "depth of first", "depth of target"]
        return contact_sheet(titled_rows(rows, titles))

    def _run(
        self, model: nn.Module, sample: Sample, *, with_intrinsics: bool
    ) -> tuple[PixelScene, Rendering]:
        scene: PixelScene = model(photos_only(sample.context, keep_intrinsics=with_intrinsics))
        target = sample.target
        with torch.autocast(target.images.device.type, enabled=False):
            cameras = cameras_of_targets(
                self.config.target_cameras, scene.geometry, sample, self.config.scale_from
            )
            rendering = render(scene.gaussians, cameras, *target.images.shape[-2:])
        return scene, rendering
