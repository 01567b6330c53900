"""`instok3d train PRESET`: the training stages."""

import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import AvoidSubcommands, arg

from instok3d.data.scenes import SceneSource
from instok3d.datasets.opening import open_training_scenes
from instok3d.training.cache.features import FeatureCache
from instok3d.training.cache.settings import check_cache
from instok3d.training.config import TrainConfig, on_backbone, overlay, preset, read_config
from instok3d.training.cost.estimate import check_memory
from instok3d.training.cost.plan import make_plan, plan_text
from instok3d.training.cost.scene_check import check_scenes
from instok3d.training.distributed import check_device
from instok3d.training.loop import train
from instok3d.weights import weights_path


@dataclass(frozen=True)
class RunArguments:
    """Where a run reads and writes."""

    data: tuple[Path, ...] = ()
    """Folders of rooms (instok3d data rooms) or of prepared scenes (instok3d data prepare); only
    those of the training split are used. --dry-run alone does without."""
    output: Annotated[Path | None, arg(aliases=["-o"])] = None
    """Folder of the run: checkpoints, metrics.jsonl, pictures, curves.png."""
    resume: bool = False
    """Go on from the newest checkpoint with the settings of the run; those given here change
    them, except that one which is the preset's own cannot be distinguished from one not given."""
    add_scenes: bool = False
    """On resuming, also train on the scenes that the folder has gained since the run began."""
    init_from: Path | None = None
    """Run folder or .safetensors file to take first weights from. A tokenizer needs one: the
    run that trained its backbone, or a tokenizer run; or else --stage.cache. An adapt run of VGGT
    begins with the published weights without it."""
    backbone: str | None = None
    """Name of another backbone than the preset's, with its default sizes, such as one that an
    installed package brings (docs/backbones.md)."""
    time_limit_min: float | None = None
    """Save and stop after so many minutes; go on later with --resume."""
    dry_run: bool = False
    """Print what the run would do and take (samples, steps, time, memory, disk, what is frozen,
    what is missing); train nothing, write nothing."""
    gpus: int | None = None
    """For the plan alone: processes, one for each GPU; None = as torchrun says, or 4 as in the
    paper, or 1 on a CPU."""
    gpu: Literal["a6000", "rtx4090", "a100", "l40s", "h100", "h200"] = "a6000"
    """For the plan alone: of which kind."""


def preset_command(name: str) -> Callable[..., None]:
    """The command that trains with a preset."""
    default = preset(name)

    def run(
        arguments: Annotated[RunArguments, arg(name="")],
        config: Annotated[AvoidSubcommands[TrainConfig], arg(name="")] = default,
    ) -> None:
        if arguments.output is None and not arguments.dry_run:
            raise ValueError("a run needs a folder: give -o RUN, or --dry-run to see the plan")
        if arguments.backbone is not None:
            config = on_backbone(config, arguments.backbone)
        if arguments.resume and arguments.output is not None:
            begun = read_config(arguments.output)
            if type(begun.stage) is not type(default.stage):
                raise ValueError(
                    f"{arguments.output} holds a run of another stage than {name}: go on with the "
                    "command that began it"
                )
            config = overlay(begun, default, config)
        if arguments.dry_run:
            show_plan(arguments, config)
        else:
            run_training(arguments, config)

    run.__doc__ = f"Train with the preset {name}; every setting can be changed."
    return run


def show_plan(arguments: RunArguments, config: TrainConfig) -> None:
    """Print what the run would do, also without scenes."""
    source = _planned_scenes(arguments.data, config)
    processes = arguments.gpus
    if processes is None:
        processes = int(os.environ.get("WORLD_SIZE", 1 if config.device == "cpu" else 4))
    plan = make_plan(
        config,
        source,
        num_gpus=processes,
        gpu=arguments.gpu,
        init_from=arguments.init_from,
        resume=arguments.resume,
    )
    print(plan_text(plan, gpu=arguments.gpu))


def _planned_scenes(folders: Sequence[Path], config: TrainConfig) -> SceneSource | None:
    """The scenes, or None where there are none yet; says so on stderr if a folder was named."""
    if not folders:
        return None
    try:
        return open_training_scenes(folders, masks=config.masks)
    except FileNotFoundError as error:
        print(f"instok3d: note: planned without scenes: {error}", file=sys.stderr)
        return None


def run_training(arguments: RunArguments, config: TrainConfig) -> None:
    """Train; one JSON object on stdout says how it ended.

    Raises:
        ValueError: A new run has no backbone to start from, or the scenes lack what it needs.
        MissingWeightsError: Published weights that it needs are not on this machine.
        NotEnoughMemoryError: A step is predicted not to fit; says which batch size would.
        KeyboardInterrupt: It was interrupted, after the checkpoint was saved.
    """
    assert arguments.output is not None
    if not arguments.data:
        raise ValueError("a run needs scenes: give --data DIR, or --dry-run to see the plan")
    source = open_training_scenes(arguments.data, masks=config.masks)
    check_device(config.device)
    check_memory(config, *check_scenes(config, source))
    stage, init_from = config.stage.build(), arguments.init_from
    if folder := config.stage.cache_folder():
        check_cache(FeatureCache(folder), config, source)
    if not (arguments.resume or init_from):
        init_from = _first_weights(config)
    outcome = train(
        config,
        stage,
        source,
        arguments.output,
        resume=arguments.resume,
        add_scenes=arguments.add_scenes,
        init_from=init_from,
        time_limit_min=arguments.time_limit_min,
    )
    if os.environ.get("RANK", "0") == "0":  # torchrun's processes share one stdout
        print(json.dumps({"step": outcome.step, "ended": outcome.reason}))
    if outcome.reason == "interrupted":
        raise KeyboardInterrupt


def _first_weights(config: TrainConfig) -> Path | None:
    """Where a new run begins by default; None: with random weights."""
    first = config.stage.first_weights()
    if first.published:
        return weights_path(first.published)
    if first.wanted:
        name = config.stage.name
        article = "an" if name[0] in "aeiou" else "a"
        raise ValueError(f"{article} {name} run needs --init-from RUN with {first.wanted}")
    return None
