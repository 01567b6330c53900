"""What the tables train: all from the same backbone, on the same rooms, for the same steps."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.data.broken_tracks import BROKEN_TRACKS
from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.tokenizer import TokenizerConfig
from instok3d.training.config import TrainConfig, preset
from instok3d.training.stages.semantics import SemanticsStageConfig
from instok3d.training.stages.tokenizer import TokenizerStageConfig

OURS = "ours"
"""The model of a file where one is given, else JOINT."""
JOINT, NO_WARMUP, RENDERING, SEQUENTIAL = "joint", "no-warmup", "rendering", "sequential"
BROKEN, SEMANTICS = "broken-tracks", "semantics"


@dataclass(frozen=True)
class Training:
    """One run, by what it differs from a preset in."""

    preset: str = "nano-tokenizer"
    stage: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the stage."""
    masks: str | None = None
    """See `TrainConfig.masks`."""
    after: str | None = None
    """The training whose model it begins with; None: the backbone."""
    share: float = 1.0
    """Of the steps of a whole run."""


TRAININGS: dict[str, Training] = {
    JOINT: Training(),
    NO_WARMUP: Training(stage={"seg_warmup_steps": 0}),
    RENDERING: Training(stage={"trained": "rendering"}, share=0.5),
    SEQUENTIAL: Training(stage={"trained": "grouping"}, after=RENDERING, share=0.5),
    BROKEN: Training(masks=BROKEN_TRACKS),
    SEMANTICS: Training("nano-semantics", after=OURS, share=0.4),
}
"""The two halves of the sequential training have half of the steps each: equal compute."""

QUICK_STEPS = 1
QUICK_SIZES = TokenizerConfig(
    width=32, num_anchors=16, num_groups=4, anchor_layers=1, group_layers=1, head_size=16,
    gaussian_head=GaussianHeadConfig(gaussians_per_anchor=4, sh_degree=1),
)  # fmt: skip


@dataclass(frozen=True)
class Schedule:
    """What all trainings have in common."""

    steps: int
    seed: int
    quick: bool
    """Tiny networks: shows that the parts fit together, and nothing else."""
    teacher: str
    """Of the semantics, as `open_teacher` takes it."""
    threads: int | None = None


def config_of(name: str, schedule: Schedule) -> TrainConfig:
    """The whole settings of a training.

    Raises:
        KeyError: There is no such training.
    """
    if name not in TRAININGS:
        raise KeyError(f"there is no training {name!r}; there are {', '.join(TRAININGS)}")
    training = TRAININGS[name]
    config = preset(training.preset)
    steps = max(1, round(schedule.steps * training.share))
    stage = replace(config.stage, **training.stage)
    if isinstance(stage, SemanticsStageConfig):
        stage = replace(stage, teacher=schedule.teacher)
    if schedule.quick:
        stage, config = _quick(stage), replace(config, holdout=1)
    return replace(
        config,
        stage=stage,
        masks=training.masks,
        seed=schedule.seed,
        steps=steps,
        warmup_steps=min(config.warmup_steps, steps // 4),
        threads=schedule.threads,
    )


def _quick(stage: Any) -> Any:
    """The stage at toy sizes, on a backbone with random weights."""
    assert isinstance(stage, TokenizerStageConfig | SemanticsStageConfig)
    stage = replace(
        stage,
        backbone=NanoConfig(width=64, layers=1),
        tokenizer=QUICK_SIZES,
    )
    if isinstance(stage, SemanticsStageConfig):
        return replace(stage, tokens=replace(stage.tokens, group_layers=1))
    return replace(stage, given_probability=0.0)


def needed(names: list[str], model_given: bool, semantics_given: bool) -> list[str]:
    """All trainings that some of them take, each behind those that it begins with.

    Args:
        names: Of trainings, or OURS.
        model_given: OURS is a file.
        semantics_given: So are its semantics.
    """
    order: list[str] = []

    def add(name: str) -> None:
        if name == OURS:
            if model_given:
                return
            name = JOINT
        if name in order or (name == SEMANTICS and semantics_given):
            return
        if (after := TRAININGS[name].after) is not None:
            add(after)
        order.append(name)

    for name in names:
        add(name)
    return order
