"""`instok3d train cache`: the frozen backbone's answers, written once for a tokenizer run."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import torch
from tyro.conf import AvoidSubcommands, arg

from instok3d.backbones.cost import Work
from instok3d.data.scenes import SceneSource
from instok3d.datasets.opening import open_training_scenes
from instok3d.model.memory import check_memory
from instok3d.progress import progress_bar
from instok3d.training.cache.settings import cached_backbone
from instok3d.training.cache.writing import FeatureType, fill_cache
from instok3d.training.checkpoint import read_weights
from instok3d.training.config import TrainConfig, on_backbone, overlay, preset
from instok3d.training.cost.estimate import samples_per_batch
from instok3d.training.distributed import check_device
from instok3d.training.stages.answers import FrozenBackbone

BASE = preset("nano-tokenizer")


@dataclass(frozen=True)
class CacheArguments:
    """What is cached, and where."""

    data: tuple[Path, ...]
    """Folders of rooms (instok3d data rooms) or of prepared scenes (instok3d data prepare)."""
    init_from: Path
    """Run folder or .safetensors file with the backbone, alone or in a tokenizer."""
    output: Annotated[Path, arg(aliases=["-o"])]
    """Folder of the cache. Scenes that are there already are kept."""
    preset: str = "nano-tokenizer"
    """The preset of the run that is to read the cache. Settings given beside it change it, except
    that one which is nano-tokenizer's own cannot be distinguished from one not given."""
    backbone: str | None = None
    """As for a run: name of another backbone than the preset's."""
    feature_type: FeatureType = "float16"
    """bfloat16 for a backbone whose features float16 cannot hold."""


def cache(
    arguments: Annotated[CacheArguments, arg(name="")],
    config: Annotated[AvoidSubcommands[TrainConfig], arg(name="")] = BASE,
) -> None:
    """Write what the frozen backbone says of every fixed sample of a tokenizer run.

    Needs --batches.samples-per-scene. The run then takes the same settings and --stage.cache, and
    neither runs nor loads the backbone. Stop it at any time and give the same command again.
    """
    config = overlay(preset(arguments.preset), BASE, config)
    if arguments.backbone is not None:
        config = on_backbone(config, arguments.backbone)
    frozen = cached_backbone(config)
    check_device(config.device)
    source = open_training_scenes(arguments.data, masks=config.masks)
    _check_memory(config, frozen, source)
    with progress_bar(len(source), unit="scene") as bar:

        def on_scene(done: int, total: int) -> None:
            bar.update()

        filled = fill_cache(
            config,
            source,
            arguments.output,
            read_weights(arguments.init_from),
            dtype=arguments.feature_type,
            on_scene=on_scene,
        )
    print(
        json.dumps(
            {
                "scenes": filled.scenes,
                "made": filled.made,
                "samples": filled.samples,
                "bytes": filled.bytes,
            }
        )
    )


def _check_memory(config: TrainConfig, frozen: FrozenBackbone, source: SceneSource) -> None:
    """Refuse what is predicted not to fit, before the backbone is made."""
    if not len(source):
        raise ValueError("the data set has no scene of the training split")
    views = max(*config.batches.views, *config.validation_views)
    height, width = source.frames(0, [0]).images.shape[1:3]
    work = Work(
        views,
        height,
        width,
        dtype=torch.bfloat16 if config.amp else torch.float32,
        batch=samples_per_batch(config, views),
    )
    check_memory(
        frozen.config,
        None,
        work,
        device=config.device,
        advice="lower --batches.views or --batches.batch-size",
    )
