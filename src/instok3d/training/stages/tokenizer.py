"""Stage "tokenizer": anchors, groups and Gaussians learn from photos and 2D masks (Sec. 3, 4)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from PIL.Image import Image
from torch import Tensor, nn

from instok3d.backbones.base import BackboneConfig, GeometryBackbone
from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.backbones.registry import build_backbone
from instok3d.data.sample import Sample, photos_only
from instok3d.evaluation.image_quality import psnr
from instok3d.evaluation.instance_ap import (
    ApSettings,
    average_precision,
    match_image,
    predicted_masks,
)
from instok3d.geometry.camera_alignment import TargetCameras
from instok3d.model.anchors import gather_rows
from instok3d.model.context import to_patches
from instok3d.model.files import save_model
from instok3d.model.tokenizer import Tokenizer, TokenizerConfig
from instok3d.objectives.assignment import AssignmentLoss, assignment_loss
from instok3d.objectives.matching import Pairs
from instok3d.objectives.rendering import rendering_loss
from instok3d.objectives.segmentation import SegmentationLoss, segmentation_loss
from instok3d.pictures import color_picture, contact_sheet, id_picture, titled_rows
from instok3d.render import render
from instok3d.training.cache.features import FeatureCache, of_backbone, with_backbone
from instok3d.training.first_weights import load_backbone
from instok3d.training.perceptual import lpips_needed, lpips_network
from instok3d.training.schedule import warmed_up
from instok3d.training.stages.answers import (
    AveragedRun,
    DataNeeds,
    FirstWeights,
    FrozenBackbone,
    NeededWeights,
    Workload,
)
from instok3d.training.stages.stage import StageConfig, StepLoss
from instok3d.training.stages.target_cameras import (
    ScaleFrom,
    cameras_of_targets,
    need_depths,
)
from instok3d.training.stages.window_samples import window_samples
from instok3d.types import Geometry, Rendering, TokenGroups

Trained = Literal["all", "rendering", "grouping"]
"""What of the tokenizer a run trains."""

GROUPING_PARTS = ("group_decoder", "assign")
"""Parts of the tokenizer that make groups; the others make Gaussians."""


@dataclass(frozen=True)
class TokenizerStageConfig(StageConfig):
    """What the tokenizer stage trains."""

    backbone: BackboneConfig = field(default_factory=NanoConfig)
    tokenizer: TokenizerConfig = field(default_factory=TokenizerConfig)
    freeze_backbone: bool = True
    """As the paper does (Sec. 4)."""
    trained: Trained = "all"
    """all: rendering and grouping together, as the paper does. rendering: what makes Gaussians, by
    the rendering loss alone. grouping: D_group and the assignment, by the grouping loss alone, the
    rest frozen; after a rendering run it is the "sequential" training of the paper's ablation."""
    given_probability: float = 0.5
    """Share of the steps that get true depth and cameras; the others see photos alone. The paper
    always predicts; one set of weights is to serve RGB-D cameras too."""
    intrinsics_probability: float = 0.5
    """Of the steps with photos alone, the share in which the intrinsics are known. The paper
    always knows them; with 1 validation does too."""
    target_cameras: TargetCameras = "aligned"
    """Where targets are rendered when cameras are not given; the paper takes the true ones."""
    scale_from: ScaleFrom = "baselines"
    """How aligned target cameras find their length in the predicted world."""
    seg_weight: float = 0.1
    """lambda_seg, the weight of the grouping loss (Eq. 6)."""
    seg_warmup_steps: int = 200
    """Steps over which seg_weight rises linearly from 0. The paper has 1,500 (Sec. 4): its
    Gaussians start anywhere, those of the nano model start on the surfaces."""
    bce_weight: float = 1.0
    """lambda_bce; the paper does not give it (Eq. 5)."""
    dice_weight: float = 1.0
    """lambda_dice; the paper does not give it (Eq. 5)."""
    assignment_weight: float = 0.0
    """Of the loss that tells each anchor the instances in its own patch
    (`objectives.assignment`), with the same warm-up; the match is then made there and holds for
    rendered maps as well. Not in the paper."""
    ignore_unlabelled: bool = False
    """Leave pixels of no instance out of the grouping loss. The paper gives them to the void."""
    l1_weight: float = 0.0
    """Mean absolute colour error; not in the paper."""
    gradient_weight: float = 0.0
    """Mean absolute error of colour differences between neighbours, for sharper renders; not in
    the paper."""
    lpips_weight: float = 0.0
    """The paper has 0.05 (Sec. 4)."""
    lpips_file: Path | None = None
    """Weights of LPIPS as safetensors; None = those of the catalogue."""
    lpips_name: str = "lpips-vgg16"
    """In the catalogue (`instok3d models list`); AlexNet is quicker on a CPU."""
    cache: Path | None = None
    """Folder of cached features (instok3d train cache); the backbone is then not even loaded."""

    def __post_init__(self):
        if self.cache and not self.freeze_backbone:
            raise ValueError("a backbone that learns cannot be cached: leave cache out")
        if self.trained == "grouping" and not self.freeze_backbone:
            raise ValueError("where grouping alone is trained the backbone stays frozen")
        if self.trained == "grouping" and self.seg_weight <= 0:
            raise ValueError(
                f"seg_weight must be above 0 where grouping alone is trained, got {self.seg_weight}"
            )

    def build(self) -> "TokenizerStage":
        """The stage of these settings."""
        return TokenizerStage(self)

    def new_model(self) -> Tokenizer:
        """See `new_tokenizer`."""
        return new_tokenizer(self)

    def workload(self) -> Workload:
        """Backbone and tokenizer."""
        return Workload(
            backbone=self.backbone,
            backbone_runs=self.cache is None,
            backbone_learns=not self.freeze_backbone,
            tokenizer=self.tokenizer,
            lpips=self.lpips_weight > 0,
        )

    def data_needs(self) -> DataNeeds:
        """Ids for the grouping loss; depth where it fixes the length of aligned cameras."""
        return DataNeeds(
            depths=need_depths(self.target_cameras, self.scale_from),
            instances=self.seg_weight > 0,
            without_instances="set --stage.seg-weight 0",
        )

    def first_weights(self) -> FirstWeights:
        """A backbone, none with cached features; for grouping alone a tokenizer."""
        if self.trained == "grouping":
            return FirstWeights(wanted="a tokenizer that has learned to render")
        return FirstWeights(wanted=None if self.cache else "a trained backbone")

    def learns_unit(self) -> bool:
        """Where targets are rendered at the true cameras."""
        return self.target_cameras == "true"

    def other_weights(self) -> tuple[NeededWeights, ...]:
        """Those of LPIPS."""
        return lpips_needed(self)

    def frozen_backbone(self) -> FrozenBackbone | None:
        """The backbone as the steps ask it; None where it learns."""
        if not self.freeze_backbone:
            return None
        with_intrinsics = max(self.given_probability, self.intrinsics_probability) > 0
        bare = self.given_probability < 1 and self.intrinsics_probability < 1
        return FrozenBackbone(
            config=self.backbone,
            inputs=(("photos",) if bare else ()) + (("intrinsics",) if with_intrinsics else ()),
            given=self.given_probability > 0,
        )

    def cache_folder(self) -> Path | None:
        """The folder of the settings."""
        return self.cache

    def export(self, run: AveragedRun, output: Path, *, half: bool) -> None:
        """Write the whole model, a cached backbone too, for `reconstruct --model`."""
        weights = run.weights
        if self.cache:
            weights = with_backbone(FeatureCache(self.cache), weights)
        model = self.new_model()
        model.load_state_dict(weights)
        save_model(model, output, card=run.card, half=half)


def new_tokenizer(
    config: TokenizerStageConfig, backbone: GeometryBackbone | None = None
) -> Tokenizer:
    """A tokenizer with random weights, on this backbone or on a new one of the config."""
    model = Tokenizer(backbone or build_backbone(config.backbone), config.tokenizer)
    model.backbone.requires_grad_(not config.freeze_backbone)
    for name, part in model.named_children():
        if name != "backbone" and config.trained != "all":
            part.requires_grad_((name in GROUPING_PARTS) == (config.trained == "grouping"))
    return model


class TokenizerStage:
    """Rendering and grouping losses of the tokenizer on a frozen backbone."""

    def __init__(self, config: TokenizerStageConfig) -> None:
        self.config = config
        self.lpips = lpips_network(config)
        self.cache = FeatureCache(config.cache) if config.cache else None

    @property
    def learns_whole(self) -> bool:
        """With a frozen backbone. One that learns has parts that not every step asks."""
        return self.config.freeze_backbone

    def build_model(self) -> Tokenizer:
        """A new tokenizer on a new backbone, which `load_initial` fills; on none with a cache."""
        backbone = self.cache.backbone(self.config.backbone) if self.cache else None
        return new_tokenizer(self.config, backbone)

    def load_initial(self, model: nn.Module, weights: Mapping[str, Tensor]) -> None:
        """All weights of a tokenizer run, or the backbone's of a geometry or adapt run.

        With cached features the backbone must be the one that made them; it is not loaded.
        """
        assert isinstance(model, Tokenizer)
        whole = any(name.startswith("anchor_decoder.") for name in weights)
        if self.config.trained == "grouping" and not whole:
            raise RuntimeError("they hold no tokenizer, of which grouping alone is to be trained")
        if self.cache:
            self.cache.check_backbone(of_backbone(weights), "the first weights")
            own = {k: v for k, v in weights.items() if whole and not k.startswith("backbone.")}
            missing, unknown = model.load_state_dict(own, strict=False)
            if unknown or (own and any(not k.startswith("backbone.") for k in missing)):
                raise RuntimeError(f"missing {missing}, unknown {unknown}")
            return
        if whole:
            model.load_state_dict(dict(weights))
        else:
            load_backbone(model.backbone, weights)

    def loss(self, model: nn.Module, sample: Sample, step: int) -> StepLoss:
        """MSE (+ LPIPS) + lambda_seg (BCE + Dice) on the target views, Eq. 4 to 6.

        Which views those are is the sampling's choice: with two contexts these and the frame
        between them, with more only frames between them (Uni3R's protocol, which Sec. 4 names).
        Of more views than the model takes at once it learns some windows (`window_samples`).
        """
        assert isinstance(model, Tokenizer)
        config = self.config
        draw, intrinsics_draw = np.random.default_rng([4, step]).random(2)
        given = bool(draw < config.given_probability)
        know_intrinsics = bool(intrinsics_draw < config.intrinsics_probability)
        geometry = self._geometry(model, sample, given=given, intrinsics=know_intrinsics)
        if 0 < (size := model.config.window_views) < sample.context.images.shape[1]:
            rng = np.random.default_rng([5, step])
            sample, geometry = window_samples(sample, geometry, size, rng)
        groups, rendering = self._render(model, sample, geometry, given=given)
        mode = "given" if given else "predicted"
        picture, terms = self._picture(rendering, sample, mode)
        total = picture if config.trained != "grouping" else 0 * picture.detach()
        if config.trained != "rendering":
            grouping, more = self._groups(model, groups, rendering, sample, step, mode)
            total, terms = total + grouping, terms | more
        terms["void"] = groups.assignment[..., -1].mean()
        return StepLoss(total, {name: value.detach() for name, value in terms.items()})

    def _picture(
        self, rendering: Rendering, sample: Sample, mode: str
    ) -> tuple[Float[Tensor, ""], dict[str, Float[Tensor, ""]]]:
        """The rendering loss and its parts."""
        config, images = self.config, sample.target.images
        lpips = self.lpips.to(images.device) if self.lpips else None
        picture = rendering_loss(
            rendering.colors, images, lpips=lpips, lpips_weight=config.lpips_weight
        )
        total, terms = picture.total, {f"mse_{mode}": picture.mse}
        if config.lpips_weight:
            terms["lpips"] = picture.lpips
        if config.l1_weight:
            total = total + config.l1_weight * (rendering.colors - images).abs().mean()
        if config.gradient_weight:
            total = total + config.gradient_weight * gradient_error(rendering.colors, images)
        return total, terms

    def _groups(
        self,
        model: Tokenizer,
        groups: TokenGroups,
        rendering: Rendering,
        sample: Sample,
        step: int,
        mode: str,
    ) -> tuple[Float[Tensor, ""], dict[str, Float[Tensor, ""]]]:
        """The weighted grouping loss and its parts."""
        config = self.config
        assert rendering.features is not None
        # The matching refuses NaN; the loop wants to see it as a loss that is not finite.
        if not rendering.features.sum().isfinite():
            return rendering.features.sum(), {}
        total, terms, pairs = rendering.features.new_zeros(()), {}, None
        warm = warmed_up(step, weight=1.0, warmup_steps=config.seg_warmup_steps)
        if config.assignment_weight:
            assigned = self._assigned(model, groups, sample)
            pairs = assigned.pairs
            total = total + warm * config.assignment_weight * assigned.total
            terms = {"assigned": assigned.total, "assigned_dice": assigned.dice}
        grouping = self._grouping(rendering, sample, pairs)
        total = total + warm * config.seg_weight * grouping.total
        terms |= {f"seg_{mode}": grouping.total, "bce": grouping.bce, "dice": grouping.dice}
        return total, terms

    @property
    def modes(self) -> tuple[Literal["predicted", "given"], ...]:
        """What validation shows the model: photos alone; also cameras and depth if it trains so."""
        return ("predicted", "given") if self.config.given_probability > 0 else ("predicted",)

    @property
    def _always_told(self) -> bool:
        return self.config.intrinsics_probability >= 1

    def _assigned(self, model: Tokenizer, groups: TokenGroups, sample: Sample) -> AssignmentLoss:
        ids = to_patches(sample.context_instances[..., None], model.backbone.patch_size).flatten(2)
        with torch.autocast(ids.device.type, enabled=False):
            return assignment_loss(
                groups.assignment.float(),
                gather_rows(ids, groups.anchors.patches),
                ignore_unlabelled=self.config.ignore_unlabelled,
            )

    def _grouping(
        self, rendering: Rendering, sample: Sample, pairs: Sequence[Pairs] | None = None
    ) -> SegmentationLoss:
        assert rendering.features is not None
        return segmentation_loss(
            rendering.features,
            sample.target_instances,
            bce_weight=self.config.bce_weight,
            dice_weight=self.config.dice_weight,
            ignore_unlabelled=self.config.ignore_unlabelled,
            pairs=pairs,
        )

    def validate(self, model: nn.Module, samples: Sequence[Sample]) -> dict[str, float]:
        """PSNR, grouping loss, AP and groups used, in each mode that is trained."""
        assert isinstance(model, Tokenizer)
        figures: dict[str, float] = {}
        for mode in self.modes:
            quality, seg, used, matches = [], [], [], []
            for sample in samples:
                groups, rendering = self._run(
                    model, sample, given=mode == "given", intrinsics=self._always_told
                )
                assert rendering.features is not None
                quality.append(psnr(rendering.colors, sample.target.images).flatten())
                seg.append(self._grouping(rendering, sample).total.item())
                used += groups_used(groups)
                matches += _matches(rendering, sample)
            precision = average_precision(matches)
            figures |= {
                f"{mode}_psnr": float(torch.cat(quality).mean()),
                f"{mode}_seg": float(np.mean(seg)),
                f"{mode}_ap": precision.ap,
                f"{mode}_ap50": precision.ap50,
                f"{mode}_ap25": precision.ap25,
                f"{mode}_groups": float(np.mean(used)),
            }
        return figures

    def pictures(self, model: nn.Module, sample: Sample) -> Image:
        """Contexts, target, true ids; then render and group ids from photos and from depth."""
        assert isinstance(model, Tokenizer)
        columns = ["context", "context", "target", "true ids"]
        for mode in self.modes:
            columns += [f"render, {mode}", f"groups, {mode}"]
        rows = [
            [
                *(color_picture(sample.context.images[k, v]) for v in (0, -1)),
                color_picture(sample.target.images[k, 0]),
                id_picture(sample.target_instances[k, 0]),
            ]
            for k in range(len(sample.names))
        ]
        for mode in self.modes:
            given = mode == "given"
            _, rendering = self._run(model, sample, given=given, intrinsics=self._always_told)
            assert rendering.features is not None
            for k, row in enumerate(rows):
                winners = predicted_masks(rendering.features[k, 0], rendering.alphas[k, 0]).ids
                row.append(color_picture(rendering.colors[k, 0]))
                row.append(id_picture(torch.from_numpy(winners) + 1))
        return contact_sheet(titled_rows(rows, columns))

    def _run(
        self, model: Tokenizer, sample: Sample, *, given: bool, intrinsics: bool = False
    ) -> tuple[TokenGroups, Rendering]:
        """Tokens from all contexts, rendered at the targets with the groups' probabilities."""
        geometry = self._geometry(model, sample, given=given, intrinsics=intrinsics)
        return self._render(model, sample, geometry, given=given)

    def _geometry(
        self, model: Tokenizer, sample: Sample, *, given: bool, intrinsics: bool
    ) -> Geometry:
        """What the backbone says of the contexts, from the cache where there is one."""
        if self.cache:
            return self.cache.geometry(sample, given=given, intrinsics=intrinsics)
        if self.config.freeze_backbone:
            model.backbone.eval()
        views = sample.context if given else photos_only(sample.context, keep_intrinsics=intrinsics)
        with torch.set_grad_enabled(torch.is_grad_enabled() and not self.config.freeze_backbone):
            return model.backbone(views)

    def _render(
        self, model: Tokenizer, sample: Sample, geometry: Geometry, *, given: bool
    ) -> tuple[TokenGroups, Rendering]:
        groups = model(photos_only(sample.context), geometry)
        target = sample.target
        with torch.autocast(target.images.device.type, enabled=False):
            kind = "true" if given else self.config.target_cameras
            cameras = cameras_of_targets(kind, geometry, sample, self.config.scale_from)
            rendering = render(
                groups.gaussians,
                cameras,
                *target.images.shape[-2:],
                anchor_features=groups.assignment[..., :-1].float(),
            )
        return groups, rendering


def gradient_error(
    images: Float[Tensor, "*batch 3 height width"], targets: Float[Tensor, "*batch 3 height width"]
) -> Float[Tensor, ""]:
    """Mean absolute error of the differences between neighbouring pixels, both directions."""
    error = images - targets
    across = (error[..., 1:] - error[..., :-1]).abs().mean()
    return across + (error[..., 1:, :] - error[..., :-1, :]).abs().mean()


def groups_used(groups: TokenGroups) -> list[int]:
    """How many groups win at least one anchor, for each scene."""
    winners = groups.assignment.argmax(dim=-1)
    void = groups.assignment.shape[-1] - 1
    return [int((scene.unique() != void).sum()) for scene in winners]


def _matches(rendering: Rendering, sample: Sample) -> list:
    assert rendering.features is not None
    settings = ApSettings(min_instance_area=20)
    ids = sample.target_instances.cpu().numpy()
    return [
        match_image(
            ids[scene, view],
            predicted_masks(rendering.features[scene, view], rendering.alphas[scene, view]),
            settings,
        )
        for scene in range(ids.shape[0])
        for view in range(ids.shape[1])
    ]
