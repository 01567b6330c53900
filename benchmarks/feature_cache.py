"""Times training steps of the nano tokenizer with its backbone and on cached features.

Processor time of one thread, so that other work on the machine counts little; steps of both kinds
in turn, on the same samples. A step is the loss, its gradients and the update.

    python benchmarks/feature_cache.py --data ROOMS
"""

import json
import statistics
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import torch
import tyro

from instok3d.data.batches import SceneBatches
from instok3d.data.sample import Sample
from instok3d.model.files import load_model
from instok3d.rooms import RoomDataset
from instok3d.training.cache.writing import fill_cache
from instok3d.training.config import preset
from instok3d.training.held_out import split_scenes
from instok3d.training.stages.tokenizer import TokenizerStage, TokenizerStageConfig


@dataclass(frozen=True)
class Options:
    """What to time."""

    data: Path
    """Folder of rooms of at least 6 training seeds."""
    views: int = 2
    batch_size: int = 4
    """As in training: in samples of two views."""
    steps: int = 10
    """Of each kind; the first two do not count."""


class Trainer:
    """A tokenizer on the shipped weights that takes steps and times them."""

    def __init__(self, stage: TokenizerStageConfig) -> None:
        self.stage = TokenizerStage(stage)
        self.model = self.stage.build_model()
        self.stage.load_initial(self.model, load_model().state_dict())
        trained = [p for p in self.model.parameters() if p.requires_grad]
        self.optimizer = torch.optim.AdamW(trained, lr=1e-6, fused=True)
        self.times_s: list[float] = []
        self.losses: list[float] = []

    def step(self, sample: Sample, number: int) -> None:
        """One update, in bfloat16 as in training."""
        start = time.process_time()
        with torch.autocast("cpu", torch.bfloat16):
            loss = self.stage.loss(self.model, sample, number).total
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        self.times_s.append(time.process_time() - start)
        self.losses.append(loss.item())


def main(options: Options) -> None:
    """Prints one JSON object: seconds of a step, their ratio, bytes of a sample."""
    torch.set_num_threads(1)
    base = preset("nano-tokenizer")
    config = replace(
        base,
        batches=replace(base.batches, batch_size=options.batch_size, views=(options.views,),
                        samples_per_scene=2),
        holdout=1,
    )  # fmt: skip
    assert isinstance(config.stage, TokenizerStageConfig)
    rooms = RoomDataset(options.data, range(16))
    names = [rooms.name_of(number) for number in range(len(rooms))]
    _, training = split_scenes(rooms, names, config.holdout)
    with tempfile.TemporaryDirectory() as folder:
        start = time.process_time()
        filled = fill_cache(config, rooms, Path(folder), load_model().state_dict())
        filling_s = time.process_time() - start
        trainers = {
            "backbone": Trainer(config.stage),
            "cache": Trainer(replace(config.stage, cache=Path(folder))),
        }
        batches = SceneBatches(rooms, training, config.batches, seed=config.seed)
        sample = batches.batch(0)
        for number in range(options.steps):
            sample = batches.batch(number)
            for trainer in trainers.values():
                trainer.step(sample, number)
    seconds = {name: statistics.median(t.times_s[2:]) for name, t in trainers.items()}
    losses = zip(*(t.losses for t in trainers.values()), strict=True)
    result = {
        "views": options.views,
        "samples in a step": len(sample.names),
        "step on the backbone (s)": round(seconds["backbone"], 3),
        "step on the cache (s)": round(seconds["cache"], 3),
        "times faster": round(seconds["backbone"] / seconds["cache"], 2),
        "largest relative difference of the losses": max(abs(a - b) / a for a, b in losses),
        "filling, a sample (s)": round(filling_s / filled.samples, 3),
        "bytes of a sample": round(filled.bytes / filled.samples),
    }
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main(tyro.cli(Options))
