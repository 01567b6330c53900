"""Stage "semantics": 2D features are distilled into a frozen tokenizer's scenes (Sec. 3.3).

Features of the context photos go in, through the frozen attention of the anchor decoder; features
of the target views are what the scene, rendered there, must give (Eq. 7, 8).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Int
from PIL.Image import Image
from torch import Tensor, nn
from torch.nn import functional

from instok3d.backbones.base import BackboneConfig
from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.backbones.registry import build_backbone
from instok3d.data.sample import Sample, photos_only
from instok3d.data.words import ObjectWords
from instok3d.geometry.camera_alignment import TargetCameras
from instok3d.model.tokenizer import Tokenizer, TokenizerConfig
from instok3d.objectives.distillation import DistillationLoss, distillation_loss
from instok3d.pictures import color_picture, contact_sheet, titled_rows
from instok3d.semantics.files import load_semantics, save_semantics, tokenizer_digest
from instok3d.semantics.model import SemanticModel
from instok3d.semantics.targets import target_map
from instok3d.semantics.teachers.file import teacher_tensors
from instok3d.semantics.teachers.opening import FORMS, open_teacher
from instok3d.semantics.teachers.rooms import RoomTeacher
from instok3d.semantics.text import load_table
from instok3d.semantics.tokens import (
    SemanticMaps,
    SemanticTokens,
    SemanticTokensConfig,
    pixel_features,
    render_semantics,
)
from instok3d.training.stages.answers import AveragedRun, DataNeeds, FirstWeights, Workload
from instok3d.training.stages.stage import StageConfig, StepLoss
from instok3d.training.stages.target_cameras import ScaleFrom, cameras_of_targets, need_depths

MIN_PIXELS = 16.0
"""At the size of the photos: groups that show fewer in a view have no second term there."""
WORDS = "words"


@runtime_checkable
class SampleTeacher(Protocol):
    """What gives the features of a batch's views."""

    name: str
    channels: int

    def __call__(
        self,
        images: Float[Tensor, "batch view 3 height width"],
        instances: Int[Tensor, "batch view height width"],
        words: Sequence[Mapping[int, ObjectWords]],
    ) -> Float[Tensor, "batch view feature row column"]:
        """Phi of the views; zeros where nothing is known."""
        ...


class PhotoTeacher:
    """An encoder of photos: instances and words are not looked at."""

    def __init__(self, text: str):
        self.teacher = open_teacher(text)
        self.name, self.channels = self.teacher.name, self.teacher.channels

    @torch.no_grad()
    def __call__(self, images, instances, words):
        """See `SampleTeacher`."""
        features = self.teacher.features(images.flatten(0, 1))  # bfloat16 under autocast
        return features.float().unflatten(0, images.shape[:2])


class WordsTeacher:
    """The true words of each instance, embedded: what a perfect encoder would say."""

    channels: int

    def __init__(self, table: Path):
        self.table = load_table(table)
        self.name, self.channels = "true-words", self.table.rows.shape[1]

    @torch.no_grad()
    def __call__(self, images, instances, words):
        """See `SampleTeacher`."""
        maps = [target_map(ids, each, self.table)[0]
                for ids, each in zip(instances, words, strict=True)]  # fmt: skip
        return torch.stack(maps)


@dataclass(frozen=True)
class SemanticsStageConfig(StageConfig):
    """What the semantics stage trains."""

    backbone: BackboneConfig = field(default_factory=NanoConfig)
    tokenizer: TokenizerConfig = field(default_factory=TokenizerConfig)
    tokens: SemanticTokensConfig = field(default_factory=SemanticTokensConfig)
    teacher: str = ""
    """The 2D encoder with its weights, such as lseg:FILE (`semantics.teachers.opening`); or
    words:TABLE, the true words of rooms in the space of a text table, as a perfect encoder."""
    start_from: str = ""
    """A file of semantics of the tokenizer (`train export`) to begin with, such as the shipped one;
    a run with more shared features, or with one level alone, takes the weights that fit it."""
    know_intrinsics: bool = False
    """Whether the tokenizer sees the intrinsics of the photos, as the paper's does."""
    target_cameras: TargetCameras = "aligned"
    """Where targets are rendered; see the tokenizer's stage."""
    scale_from: ScaleFrom = "baselines"
    """How aligned target cameras find their length in the predicted world."""

    def build(self) -> "SemanticsStage":
        """The stage of these settings, with the teacher's weights."""
        return SemanticsStage(self)

    def new_model(self) -> "SemanticRun":
        """A frozen tokenizer beside what learns."""
        return SemanticRun(Tokenizer(build_backbone(self.backbone), self.tokenizer), self.tokens)

    def workload(self) -> Workload:
        """Backbone and tokenizer, which do not learn."""
        return Workload(backbone=self.backbone, backbone_learns=False, tokenizer=self.tokenizer)

    def data_needs(self) -> DataNeeds:
        """Depth where it fixes the length of aligned cameras."""
        return DataNeeds(depths=need_depths(self.target_cameras, self.scale_from))

    def first_weights(self) -> FirstWeights:
        """Those of a tokenizer, which stay as they are."""
        return FirstWeights(wanted="a trained tokenizer")

    def learns_unit(self) -> bool:
        """Where targets are rendered at the true cameras."""
        return self.target_cameras == "true"

    def export(self, run: AveragedRun, output: Path, *, half: bool) -> None:
        """Write the semantics, with the hash of the tokenizer that they belong to.

        The encoder of rooms goes along; others stay where they are.
        """
        model = self.new_model()
        model.load_state_dict(run.weights)
        teacher = opened(self.teacher)
        encoder = teacher.teacher if isinstance(teacher, PhotoTeacher) else None
        save_semantics(
            model.semantic, output, encoder=teacher.name, card=self._card(run), half=half,
            tokenizer_sha256=tokenizer_digest(model.tokenizer),
            beside=teacher_tensors(encoder) if isinstance(encoder, RoomTeacher) else ({}, {}),
        )  # fmt: skip

    def _card(self, run: AveragedRun) -> dict[str, Any]:
        """The card with the name of the teacher's file alone: files travel, folders are private."""
        config = run.card.get("config")
        if config is None:
            return run.card
        kind, _, place = self.teacher.partition(":")
        named = {"teacher": f"{kind}:{Path(place).name}", "start_from": Path(self.start_from).name}
        stage = {**config["stage"], **named}
        return {**run.card, "config": {**config, "stage": stage}}


def opened(teacher: str) -> SampleTeacher:
    """The teacher of the settings.

    Raises:
        ValueError: The text names none.
        FileNotFoundError: There are no such weights.
    """
    kind, _, place = teacher.partition(":")
    if kind == WORDS and place:
        return WordsTeacher(Path(place))
    if kind not in {form.partition(":")[0] for form in FORMS} or not place:
        forms = ", ".join((f"{WORDS}:TABLE", *FORMS))
        raise ValueError(f"stage.teacher {teacher!r} names no teacher; wanted is one of {forms}")
    return PhotoTeacher(teacher)


class SemanticRun(nn.Module):
    """A frozen tokenizer and the semantic model that learns on it."""

    def __init__(self, tokenizer: Tokenizer, config: SemanticTokensConfig):
        super().__init__()
        self.tokenizer = tokenizer.requires_grad_(False)
        self.semantic = SemanticModel(tokenizer, config)

    def train(self, mode: bool = True) -> "SemanticRun":
        """The tokenizer stays in evaluation."""
        super().train(mode)
        self.tokenizer.eval()
        return self


@dataclass(frozen=True)
class Distilled:
    """A batch's scenes at its targets, beside what the teacher says of these."""

    maps: SemanticMaps
    """At the teacher's resolution."""
    tokens: SemanticTokens
    features: Float[Tensor, "batch view feature row column"]
    """F."""
    teacher: Float[Tensor, "batch view feature row column"]
    """Phi."""


class SemanticsStage:
    """The distillation loss at the target views."""

    def __init__(self, config: SemanticsStageConfig) -> None:
        self.config, self.teacher = config, opened(config.teacher)
        if self.teacher.channels != config.tokens.feature_channels:
            raise ValueError(
                f"the teacher {self.teacher.name} has {self.teacher.channels} channels, not "
                f"{config.tokens.feature_channels}: set --stage.tokens.feature-channels"
            )

    @property
    def learns_whole(self) -> bool:
        """Yes; every part is in every feature."""
        return True

    def build_model(self) -> SemanticRun:
        """A new semantic model on a tokenizer that `load_initial` fills."""
        return self.config.new_model()

    def load_initial(self, model: nn.Module, weights: Mapping[str, Tensor]) -> None:
        """The weights of a tokenizer, or all of a semantics run.

        Raises:
            FileNotFoundError: There is no file `start_from`.
            ValueError: That file is not of this tokenizer or of other sizes, or the weights are
                those of a run, which has begun already.
        """
        assert isinstance(model, SemanticRun)
        whole = any(name.startswith("semantic.") for name in weights)
        (model if whole else model.tokenizer).load_state_dict(dict(weights))
        if not self.config.start_from:
            return
        if whole:
            raise ValueError(
                f"stage.start_from is {self.config.start_from}, but --init-from is a semantics run "
                "that brings its own weights: give one of them, or a tokenizer to --init-from"
            )
        begun = load_semantics(Path(self.config.start_from), model.tokenizer)
        model.semantic.start_from(begun.model)

    def loss(self, model: nn.Module, sample: Sample, step: int) -> StepLoss:
        """Both terms of Eq. 8 on the target views."""
        assert isinstance(model, SemanticRun)
        loss = self._distillation(self._distil(model, sample), sample)
        terms = {"pixels": loss.pixels.detach(), "groups": loss.groups.detach()}
        return StepLoss(loss.total, terms)

    def validate(self, model: nn.Module, samples: Sequence[Sample]) -> dict[str, float]:
        """Cosines with the teacher: of pixels, with and without residuals, and of groups."""
        assert isinstance(model, SemanticRun)
        figures: dict[str, list[float]] = {name: [] for name in ("pixels", "shared", "groups")}
        for sample in samples:
            done = self._distil(model, sample)
            loss = self._distillation(done, sample)
            bare = pixel_features(
                SemanticMaps(done.maps.shares, 0 * done.maps.residuals), done.tokens
            )
            shared = functional.cosine_similarity(bare, done.teacher, dim=2).mean()
            figures["pixels"].append(1 - loss.pixels.item())
            figures["shared"].append(shared.item())
            figures["groups"].append(1 - loss.groups.item())
        return {f"cosine_{name}": float(np.mean(values)) for name, values in figures.items()}

    def pictures(self, model: nn.Module, sample: Sample) -> Image:
        """Target, the teacher's features of it and the scene's, in the same three directions."""
        assert isinstance(model, SemanticRun)
        done = self._distil(model, sample)
        rows = []
        for k in range(len(sample.names)):
            teacher, own = done.teacher[k, 0].flatten(1).T, done.features[k, 0].flatten(1).T
            directions = torch.linalg.svd(functional.normalize(teacher, dim=1), full_matrices=False)
            shape = done.teacher.shape[-2:]
            rows.append(
                [
                    color_picture(functional.interpolate(sample.target.images[k, :1], shape)[0]),
                    *(
                        color_picture(
                            (functional.normalize(each, dim=1) @ directions.Vh[:3].T * 0.5 + 0.5)
                            .clamp(0, 1).T.unflatten(1, shape)
                        )
                        for each in (teacher, own)
                    ),
                ]
            )  # fmt: skip
        return contact_sheet(titled_rows(rows, ["target", "features, 2D", "features, scene"]))

    def _distil(self, model: SemanticRun, sample: Sample) -> Distilled:
        context, target = sample.context, sample.target
        shown = self.teacher(context.images, sample.context_instances, sample.words)
        wanted = self.teacher(target.images, sample.target_instances, sample.words)
        photos = photos_only(context, keep_intrinsics=self.config.know_intrinsics)
        groups, tokens = model.semantic(model.tokenizer, photos, shown)
        with torch.autocast(target.images.device.type, enabled=False):
            cameras = cameras_of_targets(
                self.config.target_cameras, groups.geometry, sample, self.config.scale_from
            )
            maps = render_semantics(
                groups.gaussians, groups.assignment.float(), tokens.map(Tensor.float), cameras,
                *target.images.shape[-2:],
            )  # fmt: skip
            # Eq. 7 is linear in the maps, so that they are brought to the teacher's size first.
            maps = maps.map(lambda each: _resized(each, wanted.shape[-2:]))
            tokens = tokens.map(Tensor.float)
            return Distilled(maps, tokens, pixel_features(maps, tokens), wanted)

    def _distillation(self, done: Distilled, sample: Sample) -> DistillationLoss:
        height, width = sample.target.images.shape[-2:]
        rows, columns = done.teacher.shape[-2:]
        with torch.autocast(done.features.device.type, enabled=False):
            return distillation_loss(
                done.features, done.maps.shares, done.tokens.shared, done.teacher,
                min_pixels=MIN_PIXELS * rows * columns / (height * width),
            )  # fmt: skip


def _resized(maps: Float[Tensor, "*outer height width"], size: torch.Size) -> Tensor:
    if maps.shape[-2:] == size:
        return maps
    flat = maps.flatten(0, -3)[:, None]
    return functional.interpolate(flat, size, mode="area")[:, 0].unflatten(0, maps.shape[:-2])
