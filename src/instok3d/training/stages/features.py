"""Stages of models that give each Gaussian a feature, in one pass: Uni3R's and C3G's way.

The backbone is frozen and answers as in the tokenizer's stage, so that all see the same geometry.
Pictures at the target views must be the photos, and features there those of a 2D encoder. Both are
learned in one run: C3G's second stage moves nothing of the first (`baselines.query_gaussians`).
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL.Image import Image
from torch import Tensor, nn
from torch.nn import functional

from instok3d.backbones.base import BackboneConfig
from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.backbones.registry import build_backbone
from instok3d.baselines.feature_files import new_model, save_feature_model
from instok3d.baselines.feature_scene import FeatureScene, render_scene
from instok3d.baselines.pixel_features import PixelFeatureConfig, PixelFeatures
from instok3d.baselines.query_gaussians import QueryGaussianConfig, QueryGaussians
from instok3d.data.sample import Sample, photos_only
from instok3d.evaluation.image_quality import psnr
from instok3d.geometry.camera_alignment import TargetCameras
from instok3d.objectives.rendering import rendering_loss
from instok3d.pictures import color_picture, contact_sheet, titled_rows
from instok3d.training.first_weights import load_backbone
from instok3d.training.perceptual import lpips_needed, lpips_network
from instok3d.training.stages.answers import (
    AveragedRun,
    DataNeeds,
    FirstWeights,
    NeededWeights,
    Workload,
)
from instok3d.training.stages.semantics import opened
from instok3d.training.stages.stage import StageConfig, StepLoss
from instok3d.training.stages.target_cameras import ScaleFrom, cameras_of_targets, need_depths
from instok3d.types import Rendering


@dataclass(frozen=True)
class FeatureStageConfig(StageConfig):
    """What the two stages have in common."""

    backbone: BackboneConfig = field(default_factory=NanoConfig)
    weights: str | None = "default"
    """Of a model in the catalogue (`instok3d models list`) whose backbone is taken, unless the run
    is given others; None = it must be."""
    teacher: str = ""
    """The 2D encoder, see the semantics stage; empty with feature_weight 0."""
    feature_weight: float = 0.2
    """Of 1 - cos to the encoder's features at the targets; as in LSM and Uni3R."""
    know_intrinsics: bool = False
    """Whether the backbone sees the intrinsics of the photos."""
    target_cameras: TargetCameras = "aligned"
    """Where targets are rendered; see the tokenizer's stage."""
    scale_from: ScaleFrom = "baselines"
    """How aligned target cameras find their length in the predicted world."""
    lpips_weight: float = 0.0
    """As the tokenizer's."""
    lpips_file: Path | None = None
    """Weights of LPIPS as safetensors; None = those of the catalogue."""
    lpips_name: str = "lpips-vgg16"
    """In the catalogue."""

    @property
    @abstractmethod
    def sizes(self) -> PixelFeatureConfig | QueryGaussianConfig:
        """Of the model beside the backbone."""

    def build(self) -> "FeatureStage":
        """The stage of these settings, with the encoder's weights."""
        return FeatureStage(self)

    def new_model(self) -> PixelFeatures | QueryGaussians:
        """With random weights; the backbone does not learn."""
        backbone = build_backbone(self.backbone).requires_grad_(False)
        return new_model(self.sizes, backbone)

    def workload(self) -> Workload:
        """The backbone does not learn."""
        return Workload(
            backbone=self.backbone, backbone_learns=False, lpips=self.lpips_weight > 0,
            pixel_parts=("head",) if isinstance(self.sizes, PixelFeatureConfig) else (),
        )  # fmt: skip

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
        """Write the model with its backbone, for `evaluate --method`."""
        model = self.new_model()
        model.load_state_dict(run.weights)
        save_feature_model(model, output, card=run.card, half=half)


@dataclass(frozen=True)
class PixelFeaturesStageConfig(FeatureStageConfig):
    """What the stage of LSM's and Uni3R's way trains."""

    model: PixelFeatureConfig = field(default_factory=PixelFeatureConfig)

    @property
    def sizes(self) -> PixelFeatureConfig:
        """Of the model beside the backbone."""
        return self.model


@dataclass(frozen=True)
class QueryGaussiansStageConfig(FeatureStageConfig):
    """What the stage of C3G's way trains."""

    model: QueryGaussianConfig = field(default_factory=QueryGaussianConfig)

    @property
    def sizes(self) -> QueryGaussianConfig:
        """Of the model beside the backbone."""
        return self.model


@dataclass(frozen=True)
class Shown:
    """A batch's scenes from its targets."""

    scene: FeatureScene
    rendering: Rendering
    features: Float[Tensor, "batch view feature row column"] | None
    """In the encoder's space, at its resolution; None where none are learned."""
    wanted: Float[Tensor, "batch view feature row column"] | None
    """What the encoder says of the targets."""


class FeatureStage:
    """Rendering loss and the angle to the encoder's features at the target views."""

    def __init__(self, config: FeatureStageConfig) -> None:
        self.config = config
        self.lpips = lpips_network(config)
        self.teacher = opened(config.teacher) if config.feature_weight else None
        if self.teacher and self.teacher.channels != config.sizes.encoder_channels:
            raise ValueError(
                f"the teacher {self.teacher.name} has {self.teacher.channels} channels, not "
                f"{config.sizes.encoder_channels}: set --stage.model.encoder-channels"
            )

    @property
    def learns_whole(self) -> bool:
        """Where features are learned too."""
        return self.teacher is not None

    def build_model(self) -> PixelFeatures | QueryGaussians:
        """A new model on a backbone that `load_initial` fills."""
        return self.config.new_model()

    def load_initial(self, model: nn.Module, weights: Mapping[str, Tensor]) -> None:
        """All weights of such a run, else the backbone's of another run or a file."""
        assert isinstance(model, PixelFeatures | QueryGaussians)
        if any(name.startswith("expand.") for name in weights):
            model.load_state_dict(dict(weights))
        else:
            load_backbone(model.backbone, weights)

    def loss(self, model: nn.Module, sample: Sample, step: int) -> StepLoss:
        """MSE (+ LPIPS) + feature_weight (1 - cos) on the target views."""
        shown = self._show(model, sample)
        images = sample.target.images
        lpips = self.lpips.to(images.device) if self.lpips else None
        picture = rendering_loss(
            shown.rendering.colors, images, lpips=lpips, lpips_weight=self.config.lpips_weight
        )
        total, terms = picture.total, {"mse": picture.mse}
        if shown.features is not None:
            angle = 1 - _cosine(shown)
            total = total + self.config.feature_weight * angle
            terms["features"] = angle
        return StepLoss(total, {name: value.detach() for name, value in terms.items()})

    def validate(self, model: nn.Module, samples: Sequence[Sample]) -> dict[str, float]:
        """PSNR, and the cosine with the encoder's features, at the targets."""
        quality, cosines = [], []
        for sample in samples:
            shown = self._show(model, sample)
            quality.append(psnr(shown.rendering.colors, sample.target.images).flatten())
            if shown.features is not None:
                cosines.append(_cosine(shown).item())
        figures = {"psnr": float(torch.cat(quality).mean())}
        return figures | ({"cosine": float(np.mean(cosines))} if cosines else {})

    def pictures(self, model: nn.Module, sample: Sample) -> Image:
        """First and last context, a target and its render."""
        colors = self._show(model, sample).rendering.colors
        rows = [
            [
                *(color_picture(sample.context.images[k, v]) for v in (0, -1)),
                color_picture(sample.target.images[k, 0]),
                color_picture(colors[k, 0]),
            ]
            for k in range(len(sample.names))
        ]
        return contact_sheet(titled_rows(rows, ["first", "last", "target", "render"]))

    def _show(self, model: nn.Module, sample: Sample) -> Shown:
        assert isinstance(model, PixelFeatures | QueryGaussians)
        model.backbone.eval()
        views = photos_only(sample.context, keep_intrinsics=self.config.know_intrinsics)
        with torch.no_grad():
            geometry = model.backbone(views)
        encoded = wanted = features = None
        if self.teacher:
            wanted = self.teacher(sample.target.images, sample.target_instances, sample.words)
            if model.takes_features:
                encoded = self.teacher(views.images, sample.context_instances, sample.words)
        scene = model(views, encoded, geometry)
        with torch.autocast(views.images.device.type, enabled=False):
            cameras = cameras_of_targets(
                self.config.target_cameras, geometry, sample, self.config.scale_from
            )
            rendering = render_scene(
                scene, cameras, *sample.target.images.shape[-2:], detach=model.detaches_gaussians
            )
            if wanted is not None:
                assert rendering.features is not None
                # The map is linear: what is rendered comes to the encoder's size first.
                maps = functional.interpolate(
                    rendering.features.flatten(0, 1), wanted.shape[-2:], mode="area"
                ).unflatten(0, wanted.shape[:2])
                features = torch.einsum("bvchw,fc->bvfhw", maps, scene.feature_map.float())
        return Shown(scene, rendering, features, wanted)


def _cosine(shown: Shown) -> Float[Tensor, ""]:
    assert shown.features is not None
    assert shown.wanted is not None
    return functional.cosine_similarity(shown.features, shown.wanted.float(), dim=2).mean()
