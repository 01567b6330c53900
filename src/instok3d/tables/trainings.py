"""What the tables train: all from the same backbone, on the same rooms, for the same hours."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.baselines.pixel_features import PixelFeatureConfig
from instok3d.baselines.query_gaussians import QueryGaussianConfig
from instok3d.baselines.segmenter import SegmenterConfig
from instok3d.data.batches import BatchConfig
from instok3d.data.broken_tracks import BROKEN_TRACKS
from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.pixel_gaussians import PixelGaussianConfig
from instok3d.model.tokenizer import TokenizerConfig
from instok3d.semantics.predictor import PredictorConfig
from instok3d.training.config import TrainConfig, preset
from instok3d.training.stages.features import (
    FeatureStageConfig,
    PixelFeaturesStageConfig,
    QueryGaussiansStageConfig,
)
from instok3d.training.stages.segmenter import SegmenterStageConfig
from instok3d.training.stages.semantics import SemanticsStageConfig
from instok3d.training.stages.stage import StageConfig
from instok3d.training.stages.tokenizer import TokenizerStageConfig

TablesOf = Literal["rooms", "scannet"]
"""What Tables 1 to 4 are made of, and what their methods are trained on."""
TrainingData = Literal["rooms", "scannet", "re10k"]

OURS = "ours"
"""The model of a file where one is given, else JOINT."""
JOINT, NO_WARMUP, RENDERING, SEQUENTIAL = "joint", "no-warmup", "rendering", "sequential"
BROKEN, SEMANTICS = "broken-tracks", "semantics"
NO_ANCHOR_LOSS, NO_SELF_ATTENTION = "no-anchor-loss", "no-self-attention"
NO_PROJECTION = "no-projection"
"""Each without one of our deviations from the paper (docs/paper_map.md)."""
LSM, UNI3R, C3G = "lsm-style", "uni3r-style", "c3g-style"
"""Models of one pass with a feature for each Gaussian (`baselines.feature_method`)."""
RE10K, RE10K_C3G = "re10k", "re10k-c3g-style"
"""Of Table 5 where the tables are made of the paper's data sets."""
SEGMENTER = "segmenter"
"""Finds the masks that methods of Table 2 are given."""

UPDATE_S = 2.6
"""Seconds of one core that an update of the tokenizer takes: 11 hours for 15,000
(runs/default_model.sh). Those of others are by their CPU time over its, in one process
(benchmarks/updates.py), about midway between an AMD EPYC and an Intel Xeon with AMX."""
SEMANTICS_UPDATES = 0.4
"""Of the semantics, over those of the tokenizer."""
SEMANTICS_UPDATE_S = 1.8


@dataclass(frozen=True)
class Training:
    """One run, by what it differs from a preset in."""

    preset: str = "nano-tokenizer"
    stage: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the stage."""
    sizes: Mapping[str, Any] = field(default_factory=dict)
    """Settings of its tokenizer."""
    data: Literal["main", "re10k"] = "main"
    """main: what Tables 1 to 4 are made of."""
    masks: str | None = None
    """See `TrainConfig.masks`."""
    after: str | None = None
    """The training whose model it begins with; None: the backbone."""
    share: float = 1.0
    """Of the time of the tokenizer's run."""
    update_s: float = UPDATE_S
    """Seconds of one core that an update takes: the number of updates follows from the time."""
    full_width: bool = False
    """Each pixel's feature has all channels of the 2D encoder, as LSM's, and not Uni3R's 64."""


_PICTURES_AND_FEATURES = 1 + SEMANTICS_UPDATES * SEMANTICS_UPDATE_S / UPDATE_S
"""Learned in one run, in the time of our two."""

TRAININGS: dict[str, Training] = {
    JOINT: Training(),
    NO_WARMUP: Training(stage={"seg_warmup_steps": 0}),
    RENDERING: Training(stage={"trained": "rendering"}, share=0.5),
    SEQUENTIAL: Training(stage={"trained": "grouping"}, after=RENDERING, share=0.5),
    BROKEN: Training(masks=BROKEN_TRACKS),
    NO_ANCHOR_LOSS: Training(stage={"assignment_weight": 0.0}),
    NO_SELF_ATTENTION: Training(
        sizes={"anchor_self_attention": False, "group_self_attention": False}
    ),
    NO_PROJECTION: Training(sizes={"project_assignment": False}),
    SEMANTICS: Training(
        "nano-semantics", after=OURS, share=_PICTURES_AND_FEATURES - 1, update_s=SEMANTICS_UPDATE_S
    ),
    LSM: Training("nano-uni3r-style", share=_PICTURES_AND_FEATURES, update_s=4.2, full_width=True),
    UNI3R: Training("nano-uni3r-style", share=_PICTURES_AND_FEATURES, update_s=2.5),
    C3G: Training("nano-c3g-style", share=_PICTURES_AND_FEATURES, update_s=6.3),
    SEGMENTER: Training("nano-segmenter", update_s=1.6),
    RE10K: Training(stage={"given_probability": 0.0}, data="re10k", masks="sam2"),
    RE10K_C3G: Training("nano-c3g-style", data="re10k", share=_PICTURES_AND_FEATURES, update_s=6.3),
}
"""The two halves of the sequential training have half of the steps each: equal compute."""

QUICK_STEPS = 1
QUICK_BACKBONE = NanoConfig(width=64, layers=1)
QUICK_SIZES = TokenizerConfig(
    width=32, num_anchors=16, num_groups=4, anchor_layers=1, group_layers=1, head_size=16,
    gaussian_head=GaussianHeadConfig(gaussians_per_anchor=4, sh_degree=1),
)  # fmt: skip


@dataclass(frozen=True)
class Schedule:
    """What all trainings have in common."""

    steps: int
    """Updates of the tokenizer's run."""
    seed: int
    quick: bool
    """Tiny networks: shows that the parts fit together, and nothing else."""
    teacher: str
    """2D encoder of all features, as `open_teacher` takes it."""
    channels: int = 256
    """Of its features; 256 has the one that comes with instok3d."""
    threads: int | None = None
    of: TablesOf = "rooms"


def data_of(name: str, schedule: Schedule) -> TrainingData:
    """What a training sees."""
    return "re10k" if TRAININGS[name].data == "re10k" else schedule.of


def config_of(name: str, schedule: Schedule) -> TrainConfig:
    """The whole settings of a training.

    Raises:
        KeyError: There is no such training.
    """
    if name not in TRAININGS:
        raise KeyError(f"there is no training {name!r}; there are {', '.join(TRAININGS)}")
    training = TRAININGS[name]
    config = preset(training.preset)
    steps = schedule.steps * training.share
    if not schedule.quick:
        steps *= UPDATE_S / training.update_s
    steps = max(1, round(steps))
    stage = _taught(replace(config.stage, **training.stage), training, schedule)
    if schedule.quick:
        batches = replace(config.batches, batch_size=1, views=(2,))
        stage, config = quick_stage(stage), replace(config, batches=batches, holdout=1)
    if training.sizes:
        assert isinstance(stage, TokenizerStageConfig)
        stage = replace(stage, tokenizer=replace(stage.tokenizer, **training.sizes))
    return replace(
        config,
        stage=stage,
        batches=_sampled(config.batches, data_of(name, schedule)),
        masks=training.masks,
        seed=schedule.seed,
        steps=steps,
        warmup_steps=min(config.warmup_steps, steps // 4),
        threads=schedule.threads,
    )


def _sampled(batches: BatchConfig, data: TrainingData) -> BatchConfig:
    """Frames as the papers draw them of their data sets."""
    if data == "rooms":
        return batches
    if data == "scannet":
        return replace(batches, sampling="scannet")
    return replace(batches, sampling="re10k", unit="baseline", views=(2,))


def _taught(stage: StageConfig, training: Training, schedule: Schedule) -> StageConfig:
    """The stage with its 2D encoder, for those that learn features."""
    channels = schedule.channels
    if isinstance(stage, SemanticsStageConfig):
        tokens = replace(stage.tokens, feature_channels=channels)
        return replace(stage, teacher=schedule.teacher, tokens=tokens)
    if isinstance(stage, FeatureStageConfig):
        stage = replace(stage, teacher=schedule.teacher)
    if isinstance(stage, PixelFeaturesStageConfig):
        head = stage.model.head
        if training.full_width:
            head = replace(head, feature_channels=channels)
        return replace(stage, model=PixelFeatureConfig(head, channels))
    if isinstance(stage, QueryGaussiansStageConfig):
        return replace(stage, model=replace(stage.model, encoder_channels=channels))
    return stage


def quick_stage(stage: StageConfig) -> StageConfig:
    """The stage at toy sizes, to begin with random weights."""
    if isinstance(stage, SegmenterStageConfig):
        predictor = PredictorConfig(32, 32, 1, 16, 16, 16)
        return replace(stage, weights=None, segmenter=SegmenterConfig(predictor, 4, 1))
    if isinstance(stage, TokenizerStageConfig):
        stage = replace(stage, given_probability=0.0)
    if isinstance(stage, SemanticsStageConfig):
        stage = replace(stage, tokens=replace(stage.tokens, group_layers=1))
    if isinstance(stage, TokenizerStageConfig | SemanticsStageConfig):
        return replace(stage, backbone=QUICK_BACKBONE, tokenizer=QUICK_SIZES)
    assert isinstance(stage, PixelFeaturesStageConfig | QueryGaussiansStageConfig)
    model = stage.model
    if isinstance(model, PixelFeatureConfig):
        head = PixelGaussianConfig(8, 0, feature_channels=model.head.feature_channels // 8)
        model = PixelFeatureConfig(head, model.encoder_channels)
    else:
        model = QueryGaussianConfig(40, 64, 1, encoder_channels=model.encoder_channels)
    return replace(stage, backbone=QUICK_BACKBONE, model=model)


def needed(names: list[str], given: Collection[str]) -> list[str]:
    """All trainings that some of them take, each behind those that it begins with.

    Args:
        names: Of trainings, or OURS.
        given: Those that files of the user stand for.
    """
    order: list[str] = []

    def add(name: str) -> None:
        if name in given:
            return
        name = JOINT if name == OURS else name
        if name in order:
            return
        if (after := TRAININGS[name].after) is not None:
            add(after)
        order.append(name)

    for name in names:
        add(name)
    return order
