"""`instok3d train`: the training stages on rooms, and the export of what they made."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import torch
from tyro.conf import AvoidSubcommands, arg

from instok3d.cli.train_cache import cache
from instok3d.data.opening import open_training_scenes
from instok3d.training.config import PRESETS, TrainConfig, overlay, preset, read_config
from instok3d.training.export import export_model
from instok3d.training.feature_settings import check_cache
from instok3d.training.geometry_stage import GeometryStage, GeometryStageConfig
from instok3d.training.loop import train
from instok3d.training.tokenizer_stage import TokenizerStage


@dataclass(frozen=True)
class RunArguments:
    """Where a run reads and writes."""

    data: Path
    """Folder of rooms (instok3d data rooms) or of prepared scenes (instok3d data prepare); only
    those of the training split are used."""
    output: Annotated[Path, arg(aliases=["-o"])]
    """Folder of the run: checkpoints, metrics.jsonl, pictures, curves.png."""
    resume: bool = False
    """Go on from the newest checkpoint with the settings of the run; those given here change
    them, except that one which is the preset's own cannot be told from one not given."""
    add_scenes: bool = False
    """On resuming, also train on the scenes that the folder has gained since the run began."""
    init_from: Path | None = None
    """Run folder or .safetensors file to take first weights from. A tokenizer needs one: the
    run that trained its backbone, or a tokenizer run; or else --stage.cache."""
    time_limit_min: float | None = None
    """Save and stop after so many minutes; go on later with --resume."""


def _command(name: str) -> Callable[..., None]:
    default = preset(name)

    def run(
        arguments: Annotated[RunArguments, arg(name="")],
        config: Annotated[AvoidSubcommands[TrainConfig], arg(name="")] = default,
    ) -> None:
        if arguments.resume:
            begun = read_config(arguments.output)
            if type(begun.stage) is not type(default.stage):
                raise ValueError(
                    f"{arguments.output} holds a run of another stage than {name}: go on with the "
                    "command that began it"
                )
            config = overlay(begun, default, config)
        run_training(arguments, config)

    run.__doc__ = f"Train with the preset {name}; every setting can be changed."
    return run


def run_training(arguments: RunArguments, config: TrainConfig) -> None:
    """Train; one JSON object on stdout says how it ended.

    Raises:
        ValueError: A new tokenizer run has no backbone to start from.
        KeyboardInterrupt: It was interrupted, after the checkpoint was saved.
    """
    source = open_training_scenes(arguments.data)
    if isinstance(config.stage, GeometryStageConfig):
        stage = GeometryStage(config.stage)
    else:
        stage = TokenizerStage(config.stage)
        if stage.cache:
            check_cache(stage.cache, config, source)
        elif not (arguments.resume or arguments.init_from):
            raise ValueError("a tokenizer run needs --init-from RUN with a trained backbone")
    outcome = train(
        config,
        stage,
        source,
        arguments.output,
        resume=arguments.resume,
        add_scenes=arguments.add_scenes,
        init_from=arguments.init_from,
        time_limit_min=arguments.time_limit_min,
    )
    print(json.dumps({"step": outcome.step, "ended": outcome.reason}))
    if outcome.reason == "interrupted":
        raise KeyboardInterrupt


def export(
    run: Annotated[Path, arg(metavar="RUN")],
    /,
    output: Annotated[Path, arg(aliases=["-o"])],
    float32: bool = False,
    notes: str = "",
) -> None:
    """Write a tokenizer run's averaged weights as one file for `reconstruct --model`.

    Args:
        run: Folder of the run; it may still be going on.
        output: The .safetensors file.
        float32: Full precision, twice the size.
        notes: Text for the model card.
    """
    torch.set_num_threads(1)
    card = export_model(run, output, half=not float32, notes=notes)
    print(json.dumps({key: card[key] for key in ("steps", "hours", "scenes", "commit")}))


COMMANDS = {**{name: _command(name) for name in PRESETS}, "cache": cache, "export": export}
