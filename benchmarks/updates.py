"""What an update of each training of the tables costs over one of the tokenizer's.

    python benchmarks/updates.py --data rooms [--updates 9] [--trainings joint segmenter]

`instok3d tables` gives its trainings equal time by the seconds of an update that
`tables/trainings.py` states. Here all trainings take turns in one process on one thread, an update
each, so that other work on the machine slows all of them alike. Each reads the batches of its own
preset, from the backbone of the default model, or all of it where a training begins with a
tokenizer; other weights are random. The first round is not counted. Printed are the mean processor
seconds of an update with its batch, their standard error, and both over the tokenizer's mean.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
import tyro

from instok3d.data.batches import SceneBatches
from instok3d.datasets.opening import open_training_scenes
from instok3d.model.files import DEFAULT_MODEL
from instok3d.semantics.query.shipped import SHIPPED
from instok3d.tables.trainings import JOINT, TRAININGS, Schedule, config_of
from instok3d.training.cache.features import of_backbone
from instok3d.training.checkpoint import read_weights
from instok3d.training.distributed import SharedLoss
from instok3d.training.update import new_state, train_step


@dataclass(frozen=True)
class Options:
    """What to measure."""

    data: Path
    """Folder of rooms to train on."""
    updates: int = 9
    """Rounds that are counted; presets of several numbers of views draw one for each."""
    trainings: tuple[str, ...] = ()
    """Beside the tokenizer's; all that see rooms by default."""


def main(options: Options) -> int:
    """Print a row for each training; the exit status."""
    torch.set_num_threads(1)
    of_rooms = [name for name, training in TRAININGS.items() if training.data == "main"]
    names = list(dict.fromkeys([JOINT, *(options.trainings or of_rooms)]))
    with TemporaryDirectory() as folder:
        steps = {name: _stepper(name, options.data, Path(folder)) for name in names}
        seconds = {name: [] for name in names}
        for _ in range(1 + options.updates):
            for name in names:
                start = time.process_time()
                steps[name]()
                seconds[name].append(time.process_time() - start)
    own = np.mean(seconds[JOINT][1:])
    print("training | s an update | over the tokenizer's\n---|---|---")
    for name in names:
        counted = np.array(seconds[name][1:])
        error = counted.std(ddof=1) / len(counted) ** 0.5 if len(counted) > 1 else np.nan
        mean = counted.mean()
        print(f"{name} | {mean:.2f} ± {error:.2f} | {mean / own:.2f} ± {error / own:.2f}")
    return 0


def _stepper(name: str, data: Path, folder: Path) -> Callable[[], None]:
    """A training that makes one update at each call."""
    schedule = Schedule(steps=3000, seed=0, quick=False, teacher=f"rooms:{SHIPPED}", threads=1)
    config = config_of(name, schedule)
    source = open_training_scenes([data], masks=config.masks)
    stage = config.stage.build()
    torch.manual_seed(0)
    model = stage.build_model()
    weights = read_weights(DEFAULT_MODEL)
    if TRAININGS[name].after is None:  # others begin with a whole tokenizer
        inner = of_backbone(weights)
        weights = {f"backbone.{key}": value for key, value in inner.items()}
    stage.load_initial(model, weights)
    state = new_state(config, model)
    scenes = list(range(len(source)))
    batches = SceneBatches(source, scenes, config.batches, seed=0)
    loss = SharedLoss(stage, model)

    def step() -> None:
        train_step(config, loss, state, [batches.batch(state.step, 0)], 1e-6, folder)
        state.step += 1

    return step


if __name__ == "__main__":
    raise SystemExit(main(tyro.cli(Options, description=__doc__)))
