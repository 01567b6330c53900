"""Settings of a training run, how they are written to and read from JSON, and the presets."""

import json
import types
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from instok3d.data.batches import BatchConfig
from instok3d.files import write_json
from instok3d.training.distributed import Strategy
from instok3d.training.geometry_stage import GeometryStageConfig
from instok3d.training.tokenizer_stage import TokenizerStageConfig


@dataclass(frozen=True)
class TrainConfig:
    """One training run. The paper's value stands behind a setting where it differs (Sec. 4)."""

    stage: GeometryStageConfig | TokenizerStageConfig
    """What is trained, with its sizes and losses."""
    batches: BatchConfig = field(default_factory=BatchConfig)
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


def preset(name: str) -> TrainConfig:
    """The settings of a named run, ready to be changed with dataclasses.replace.

    Raises:
        KeyError: There is no such preset.
    """
    if name not in PRESETS:
        raise KeyError(f"no preset {name!r}; there are {sorted(PRESETS)}")
    return PRESETS[name]


PRESETS = {
    "nano-geometry": TrainConfig(
        stage=GeometryStageConfig(),
        batches=BatchConfig(batch_size=4, views=(2, 2, 2, 2, 2, 3, 4, 8), num_targets=1),
        lr=6e-4,
        warmup_steps=200,
        clip_norm=1.0,
    ),
    "nano-tokenizer": TrainConfig(
        stage=TokenizerStageConfig(),
        batches=BatchConfig(batch_size=4, views=(2, 2, 2, 2, 2, 4, 8), num_targets=2),
        lr=1e-4,
        warmup_steps=100,
    ),
}
"""The nano runs are this project's own; the paper trains at full size only."""


def write_config(folder: Path, config: TrainConfig, **about: str) -> None:
    """Write RUN/config.json: the settings, and what else is known of the run."""
    write_json(folder / "config.json", {"config": to_json(config), **about})


def read_config(folder: Path) -> TrainConfig:
    """The settings of a run.

    Raises:
        FileNotFoundError: The folder holds no run.
    """
    path = folder / "config.json"
    if not path.is_file():
        raise FileNotFoundError(f"{folder} holds no run: there is no config.json in it")
    return from_json(TrainConfig, json.loads(path.read_text())["config"])


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
    """What `to_json` wrote, as `kind` again.

    Raises:
        KeyError: A key that the dataclass does not have.
        ValueError: A value of another type than the field's.
    """
    if is_dataclass(kind) and isinstance(value, dict):
        return _dataclass_from_json(kind, value, where)
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return from_json(_member(arguments, value, where), value, where)
    if origin is Literal and value in arguments:
        return value
    if origin is tuple and isinstance(value, list):
        each = arguments[:1] * len(value) if arguments[-1] is Ellipsis else arguments
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


def _member(arguments: tuple[Any, ...], value: Any, where: str) -> Any:
    """The type among those of a union that the value was written from."""
    for kind in arguments:
        if is_dataclass(kind):
            if isinstance(value, dict) and value.get("type") == getattr(kind, "__name__", None):
                return kind
        elif (kind is type(None)) == (value is None):
            return kind
    raise ValueError(f"{where} must be one of {arguments}, got {value!r}")
