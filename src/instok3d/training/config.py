"""Settings of a training run, how they are written to and read from JSON, and the presets."""

import re
import types
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from inspect import isabstract
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from instok3d.backbones.base import BackboneConfig
from instok3d.backbones.registry import config_named, kind_named
from instok3d.backbones.vggt import PAPER_VGGT
from instok3d.data.batches import BatchConfig
from instok3d.data.sensor import SensorConfig
from instok3d.files import write_json
from instok3d.model.pixel_gaussians import PixelGaussianConfig
from instok3d.model.tokenizer import PAPER
from instok3d.reading import naming_damage, read_json
from instok3d.semantics.tokens import SemanticTokensConfig
from instok3d.training.distributed import Strategy
from instok3d.training.stages.adapt import AdaptStageConfig
from instok3d.training.stages.features import (
    PixelFeaturesStageConfig,
    QueryGaussiansStageConfig,
)
from instok3d.training.stages.geometry import GeometryStageConfig
from instok3d.training.stages.segmenter import SegmenterStageConfig
from instok3d.training.stages.semantics import SemanticsStageConfig
from instok3d.training.stages.stage import StageConfig
from instok3d.training.stages.tokenizer import TokenizerStageConfig


@dataclass(frozen=True)
class TrainConfig:
    """One training run. The paper's value stands behind a setting where it differs (Sec. 4)."""

    stage: StageConfig
    """What is trained, with its sizes and losses."""
    batches: BatchConfig = field(default_factory=BatchConfig)
    masks: str | None = None
    """Learn from the masks that this model made (instok3d data masks), such as sam2, instead of
    the true instance ids; of rooms, broken-tracks: true masks whose ids break over the frames as
    those of a tracker do."""
    seed: int = 0
    steps: int = 20_000
    """Updates of the whole run."""
    cosine_steps: int | None = None
    """Where the learning rate reaches its end; None = at the last step."""
    lr: float = 5e-4
    """Peak of the learning rate; the paper has 1e-4."""
    warmup_steps: int = 500
    """Steps of linear rise of the learning rate."""
    final_lr_fraction: float = 0.01
    weight_decay: float = 0.05
    """On the weights of linear and convolution layers alone: not on norms, biases, embeddings."""
    backbone_lr_factor: float = 1.0
    """Learning rate of a backbone that learns beside other parts, over theirs; Uni3R, whose
    protocol the paper follows, has 0.1. A layer for intrinsics is new and learns as the others."""
    backbone_weight_decay: float | None = None
    """None = as the other parts; Uni3R has 0."""
    betas: tuple[float, float] = (0.9, 0.95)
    clip_norm: float = 0.5
    """Largest norm of the whole gradient (Sec. 4)."""
    max_skipped_in_a_row: int = 10
    """Updates with a finite loss but a non-finite gradient are skipped; this many stop the run."""
    accumulate: int = 1
    """Batches whose gradients are averaged before an update. An update sees batch_size *
    accumulate * processes samples; the paper has 32."""
    readers: int = 1
    """Threads that read batches ahead; the batches do not depend on it."""
    strategy: Strategy = "auto"
    """How processes that torchrun starts share the model: ddp, each holds all of it, or fsdp, each
    holds a part of every tensor; auto = ddp. A process that is alone holds all of it."""
    ema_decay: float = 0.999
    """Of the weight average that is validated and exported; 0 = the weights themselves."""
    amp: bool = True
    """bfloat16 autocast; rendering, matching and camera maths stay float32."""
    device: str = "cpu"
    """cpu; cuda, one GPU for each process; or cuda:N for one process alone."""
    threads: int | None = None
    """CPU threads; None = as torch chooses."""
    holdout: int = 24
    """The first scenes of the data set, never trained on, are what validation looks at."""
    validation_views: tuple[int, ...] = (2,)
    """2: contexts i-1 and i+1, target i. 8: the eight-view protocol."""
    validate_every_s: float = 240.0
    validate_every_steps: int = 0
    """Also at multiples of this step; 0 = by time alone."""
    checkpoint_every_s: float = 300.0
    checkpoint_every_steps: int = 0
    log_every_steps: int = 50

    def __post_init__(self):
        for name, least in _LEAST.items():
            value = getattr(self, name)
            if value < least:
                raise ValueError(f"{name} must be at least {least}, got {value}")
        if self.clip_norm <= 0:
            raise ValueError(f"clip_norm must be above 0, got {self.clip_norm}")
        if not re.fullmatch(r"cpu|cuda(:\d+)?", self.device):
            raise ValueError(f"device must be cpu, cuda or cuda:N, got {self.device!r}")
        if not self.validation_views:
            raise ValueError("validation_views must hold 2 or 8, got none")


_LEAST = {"steps": 0, "warmup_steps": 0, "accumulate": 1, "readers": 1, "log_every_steps": 1}
"""The smallest value of a setting that counts something."""


def preset(name: str) -> TrainConfig:
    """The settings of a named run, ready to be changed with dataclasses.replace.

    Raises:
        KeyError: There is no such preset.
    """
    if name not in PRESETS:
        raise KeyError(f"no preset {name!r}; there are {sorted(PRESETS)}")
    return PRESETS[name]


_SCANNET_PAIRS = BatchConfig(
    batch_size=4, views=(2,), num_targets=3, photometric=False, sampling="scannet"
)
_RE10K_PAIRS = replace(_SCANNET_PAIRS, sampling="re10k", unit="baseline")

SCANNET_ADAPT = TrainConfig(
    stage=AdaptStageConfig(
        backbone=replace(PAPER_VGGT, checkpoint_blocks=True),
        weights="vggt-1b",
        trained=("aggregator", "point_head"),
        head=PixelGaussianConfig(width=128),
    ),
    batches=_SCANNET_PAIRS,
    steps=1_600,
    lr=1e-4,
    warmup_steps=160,
    backbone_lr_factor=0.1,
    backbone_weight_decay=0.0,
    accumulate=2,
    strategy="fsdp",
    ema_decay=0.0,
    device="cuda",
    holdout=8,
    validate_every_s=1800.0,
    checkpoint_every_s=1800.0,
)
"""VGGT learns the metres of ScanNet (Sec. 4: "a few epochs", under 6 hours on 4 H200).

The paper gives no more. Uni3R's recipe: the whole of VGGT at a tenth of the learning rate of 1e-4,
without weight decay; MSE + 0.05 LPIPS at both contexts and the frame between them; ten epochs of
5,000 samples, 32 a step. Batches of 4 in 4 processes, twice before each update, are 32 samples."""

SCANNET_2VIEW = TrainConfig(
    stage=TokenizerStageConfig(
        backbone=PAPER_VGGT,
        tokenizer=PAPER,
        given_probability=0.0,
        intrinsics_probability=1.0,
        target_cameras="true",
        seg_weight=0.1,
        seg_warmup_steps=1_500,
        lpips_weight=0.05,
    ),
    batches=_SCANNET_PAIRS,
    steps=31_000,
    lr=1e-4,
    warmup_steps=3_000,
    final_lr_fraction=0.01,
    weight_decay=0.05,
    clip_norm=0.5,
    accumulate=2,
    ema_decay=0.0,
    device="cuda",
    holdout=8,
    validation_views=(2,),
    validate_every_s=1800.0,
    checkpoint_every_s=1800.0,
)
"""The tokenizer with two views (Sec. 4: about 20 hours on 4 RTX A6000).

From the paper: sizes (`model.tokenizer.PAPER`), frozen VGGT with true intrinsics, lambda_lpips
0.05, lambda_seg 0.1 after 1,500 steps, AdamW with 1e-4 down to 1e-6 and weight decay 0.05,
clipping at 0.5, bfloat16. From Uni3R, whose protocol the paper follows: 31,000 updates of 32
samples, a tenth of them warm-up; frames 2 or 4 apart; contexts and the frame between them are
supervised, at true cameras in metres. The paper does not give lambda_bce and lambda_dice: 1.
Batches of 4 in 4 processes, twice before each update, are 32 samples."""

SCANNET_8VIEW = replace(
    SCANNET_2VIEW,
    batches=replace(_SCANNET_PAIRS, batch_size=8, views=(8,)),
    steps=15_000,
    warmup_steps=1_500,
    accumulate=4,
    validation_views=(8,),
)
"""The tokenizer with eight views (Sec. 4: about 12 hours on 4 H200).

As with two, but for Uni3R's numbers: 15,000 updates, contexts 2 or 4 frames from each other, the
seven frames between them supervised and not the contexts. 2 samples of 8 views in 4 processes, four
times before each update, are 32."""

RE10K_ADAPT = replace(SCANNET_ADAPT, batches=_RE10K_PAIRS)
"""VGGT learns that the unit is the distance of the two contexts: RealEstate10K has no metres, so
the rule of C3G has to be learned as ScanNet's metres have (App. C.1)."""

SCANNET_SEMANTICS = replace(
    SCANNET_2VIEW,
    stage=SemanticsStageConfig(
        backbone=PAPER_VGGT, tokenizer=PAPER, know_intrinsics=True, target_cameras="true"
    ),
)  # fmt: skip
"""Features of LSeg on the tokenizer with two views. The paper says no more than that all else is
frozen (Sec. 3.3); steps and rates are those of the tokenizer."""

RE10K_2VIEW = replace(SCANNET_2VIEW, batches=_RE10K_PAIRS, masks="sam2")
"""The tokenizer on RealEstate10K with masks of SAM 2 (App. C.1: all else as on ScanNet).

Frames by C3G's rule: contexts 25 frames apart at first, later 45 to 90, one new frame between them.
Lengths are in distances of the two contexts, and so are the bounds of the Gaussians."""

_NANO_PAIRS = BatchConfig(batch_size=4, views=(2, 2, 4), num_targets=1, mirror=True)

_EXACT_MATCHES = SensorConfig(distortion_px=0.0)
"""Matches are learnt from true depth and cameras, which know no distortion."""

PRESETS = {
    "scannet-adapt": SCANNET_ADAPT,
    "scannet-2view": SCANNET_2VIEW,
    "scannet-8view": SCANNET_8VIEW,
    "scannet-semantics": SCANNET_SEMANTICS,
    "re10k-adapt": RE10K_ADAPT,
    "re10k-2view": RE10K_2VIEW,
    "nano-geometry": TrainConfig(
        stage=GeometryStageConfig(),
        batches=BatchConfig(
            batch_size=4,
            views=(2, 2, 2, 2, 2, 3, 4, 8),
            num_targets=1,
            sensor=_EXACT_MATCHES,
            mirror=True,
        ),
        lr=6e-4,
        warmup_steps=200,
        clip_norm=1.0,
    ),
    "nano-refinement": TrainConfig(
        stage=GeometryStageConfig(trained="refinement"),
        batches=BatchConfig(
            batch_size=4,
            views=(2, 2, 2, 4, 8, 8),
            num_targets=1,
            sensor=_EXACT_MATCHES,
            mirror=True,
        ),
        steps=1_500,
        lr=6e-4,
        warmup_steps=100,
        clip_norm=1.0,
        ema_decay=0.995,
    ),
    "nano-tokenizer": TrainConfig(
        stage=TokenizerStageConfig(given_probability=0.4, assignment_weight=0.1),
        batches=BatchConfig(batch_size=4, views=(2, 4, 4, 4, 4), num_targets=1, mirror=True),
        lr=1e-4,
        warmup_steps=100,
        clip_norm=0.3,
    ),
    "nano-semantics": TrainConfig(
        stage=SemanticsStageConfig(
            tokens=SemanticTokensConfig(feature_channels=256, group_layers=2, stream_mlp_ratio=1)
        ),
        batches=BatchConfig(batch_size=2, views=(2, 2, 4), num_targets=1, mirror=True),
        steps=4_000,
        lr=3e-4,
        warmup_steps=100,
        clip_norm=1.0,
    ),
    "nano-uni3r-style": TrainConfig(
        stage=PixelFeaturesStageConfig(),
        batches=_NANO_PAIRS,
        lr=1e-4,
        warmup_steps=100,
        clip_norm=0.3,
    ),
    "nano-c3g-style": TrainConfig(
        stage=QueryGaussiansStageConfig(),
        batches=_NANO_PAIRS,
        lr=3e-4,
        warmup_steps=100,
        clip_norm=0.3,
    ),
    "nano-segmenter": TrainConfig(
        stage=SegmenterStageConfig(),
        batches=BatchConfig(batch_size=4, views=(2,), num_targets=1, mirror=True),
        lr=3e-4,
        warmup_steps=100,
        clip_norm=1.0,
    ),
    "nano-adapt": TrainConfig(
        stage=AdaptStageConfig(
            weights="default",
            trained=("to_coarse_depth", "to_half", "to_fine_depth"),
            head=PixelGaussianConfig(width=32),
            lpips_weight=0.0,
        ),
        batches=BatchConfig(batch_size=4, views=(2,), num_targets=3, photometric=False),
        steps=2_000,
        lr=1e-4,
        warmup_steps=50,
    ),
}
"""The nano runs are this project's own; the paper trains at full size only. nano-adapt begins
with the backbone of the shipped model, leaves the matches alone, which its loss does not see, and
moves the depths."""


def on_backbone(config: TrainConfig, name: str) -> TrainConfig:
    """The same run on another backbone, with the default sizes of that one.

    Args:
        config: A run of a stage that takes any backbone, as the tokenizer's and adapt.
        name: Of a registered backbone.

    Raises:
        ValueError: No backbone has that name, or the stage has losses for one of its own.
    """
    if get_type_hints(type(config.stage)).get("backbone") is not BackboneConfig:
        raise ValueError(
            f"the {config.stage.name} stage has losses for a backbone of its own, it cannot train "
            f"{name!r}: train that one by its own means, then give its weights with --init-from"
        )
    return replace(config, stage=replace(config.stage, backbone=kind_named(name).config()))


def write_config(folder: Path, config: TrainConfig, **about: str) -> None:
    """Write RUN/config.json: the settings, and what else is known of the run."""
    write_json(folder / "config.json", {"config": to_json(config), **about})


REMEDY = "restore config.json, or start the run anew in another folder"
"""What to do about damaged settings of a run."""


def read_config(folder: Path) -> TrainConfig:
    """The settings of a run.

    Raises:
        FileNotFoundError: The folder holds no run.
        ValueError: Its settings are damaged.
    """
    path = folder / "config.json"
    if not path.is_file():
        raise FileNotFoundError(f"{folder} holds no run: there is no config.json in it")
    with naming_damage(path, REMEDY):
        config = from_json(TrainConfig, read_json(path, REMEDY)["config"])
        if not isinstance(config, TrainConfig):
            raise ValueError("it holds no settings of a run")
        return config


def overlay(base: Any, default: Any, wanted: Any) -> Any:
    """The base with every setting, nested ones too, in which `wanted` is not the default."""
    if not is_dataclass(base) or isinstance(base, type) or type(base) is not type(wanted):
        return base if wanted == default else wanted
    names = [f.name for f in fields(base)]
    values = {n: overlay(*(getattr(x, n) for x in (base, default, wanted))) for n in names}
    return replace(base, **values)


def to_json(config: Any) -> Any:
    """Dataclasses as dictionaries with their class name under "type"; tuples as lists."""
    if is_dataclass(config) and not isinstance(config, type):
        content = {f.name: to_json(getattr(config, f.name)) for f in fields(config)}
        return {"type": type(config).__name__, **content}
    if isinstance(config, tuple | list):
        return [to_json(value) for value in config]
    return str(config) if isinstance(config, Path) else config


def from_json(kind: Any, value: Any, where: str = "config") -> Any:
    """What `to_json` wrote, as `kind` again, or as the subclass of it that was written.

    Raises:
        KeyError: A key that the dataclass does not have.
        ValueError: A value of another type than the field's, or sizes of a backbone that is not
            registered.
    """
    if kind is BackboneConfig and isinstance(value, dict):
        kind = config_named(str(value.get("type")))
    if is_dataclass(kind) and isinstance(value, dict):
        return _dataclass_from_json(_written_class(kind, value, where), value, where)
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return from_json(_member(arguments, value, where), value, where)
    if origin is Literal and value in arguments:
        return value
    if origin in (tuple, Sequence) and isinstance(value, list):
        same = origin is Sequence or arguments[-1] is Ellipsis
        each = arguments[:1] * len(value) if same else arguments
        if len(each) == len(value):
            return tuple(from_json(k, v, where) for k, v in zip(each, value, strict=True))
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if kind is Path and isinstance(value, str):
        return Path(value)
    if isinstance(kind, type) and type(value) is kind:
        return value
    raise ValueError(f"{where} must be {kind}, got {value!r}")


def _dataclass_from_json(kind: Any, value: dict[str, Any], where: str) -> Any:
    hints = get_type_hints(kind)
    content = {key: v for key, v in value.items() if key != "type"}
    known = [f.name for f in fields(kind)]
    unknown = sorted(set(content) - set(known))
    if unknown:
        raise KeyError(f"{where} has no setting {unknown}; it has {known}")
    return kind(**{k: from_json(hints[k], v, f"{where}.{k}") for k, v in content.items()})


def _subclasses(kind: type) -> set[type]:
    """Of all depths."""
    direct = set(kind.__subclasses__())
    return direct.union(*(_subclasses(each) for each in direct))


def _written_class(kind: Any, value: dict[str, Any], where: str) -> Any:
    """The class, or the subclass of an abstract one, that a dictionary was written from."""
    if not isabstract(kind):
        return kind
    known = {each.__name__: each for each in _subclasses(kind) if not isabstract(each)}
    if value.get("type") not in known:
        raise ValueError(
            f"{where} must be of one of the types {sorted(known)}, got {value.get('type')!r}"
        )
    return known[value["type"]]


def _member(arguments: tuple[Any, ...], value: Any, where: str) -> Any:
    """The type among those of a union that the value was written from."""
    for kind in arguments:
        if is_dataclass(kind):
            if isinstance(value, dict) and value.get("type") == getattr(kind, "__name__", None):
                return kind
        elif (kind is type(None)) == (value is None):
            return kind
    raise ValueError(f"{where} must be one of {arguments}, got {value!r}")
