"""The training loop, read from top to bottom: validate, picture, save, step, log."""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch

from instok3d.data.batches import SceneBatches
from instok3d.data.sample import Sample
from instok3d.data.scenes import SceneSource
from instok3d.files import replacing
from instok3d.training.checkpoint import (
    RunState,
    WeightAverage,
    current_commit,
    read_checkpoint,
    read_weights,
    restore,
    save_checkpoint,
)
from instok3d.training.config import TrainConfig, to_json, write_config
from instok3d.training.held_out import split_scenes, validation_samples
from instok3d.training.plots import plot_curves
from instok3d.training.run_log import RunLog, RunningMeans
from instok3d.training.schedule import learning_rate
from instok3d.training.stages import Stage
from instok3d.training.update import new_state, train_step


@dataclass(frozen=True)
class TrainOutcome:
    """How a run ended."""

    step: int
    reason: Literal["finished", "time limit", "interrupted"]


def train(
    config: TrainConfig,
    stage: Stage,
    source: SceneSource,
    folder: Path,
    *,
    resume: bool = False,
    add_scenes: bool = False,
    init_from: Path | None = None,
    time_limit_min: float | None = None,
) -> TrainOutcome:
    """Train one stage and leave checkpoints, metrics, pictures and curves in `folder`.

    SIGINT and SIGTERM end the run after the update in hand, with a checkpoint; a second one
    ends it at once.

    Args:
        config: Settings; on resuming they must be those of the run except where it ends.
        stage: What is trained, built from config.stage.
        source: Scenes. The run uses those that are there when it starts, also after resuming.
        folder: The run.
        resume: Go on from the newest checkpoint; bit for bit as if it had not stopped.
        add_scenes: On resuming, also use the scenes that the data set has gained since; the run is
            then a new one from here on. The held-out scenes stay the same.
        init_from: A run folder or .safetensors file to take first weights from.
        time_limit_min: Stop with a checkpoint after this many minutes of this call.

    Raises:
        ValueError: The folder holds a run and resume is off, the data set is too small, or the
            first weights do not fit.
        FileNotFoundError: Nothing to resume.
        NonFiniteLossError: Training diverged.
    """
    if config.threads:
        torch.set_num_threads(config.threads)
    torch.manual_seed(config.seed)
    folder.mkdir(parents=True, exist_ok=True)
    state = new_state(config, stage)
    all_names = [source.name_of(number) for number in range(len(source))]
    if resume:
        restore(state, read_checkpoint(folder))
        if add_scenes:
            known = set(state.scene_names)
            state.scene_names += [name for name in all_names if name not in known]
    elif (folder / "checkpoints").exists():
        raise ValueError(f"{folder} holds a run: pass --resume to go on or choose another folder")
    else:
        state.scene_names = all_names
        if init_from is not None:
            try:
                stage.load_initial(state.model, read_weights(init_from))
            except RuntimeError as error:
                raise ValueError(
                    f"{init_from} does not fit the sizes of this run: {error}"
                ) from error
            state.average = WeightAverage(state.model, config.ema_decay)
    write_config(folder, config, commit=current_commit())
    held_out, training = split_scenes(source, state.scene_names, config.holdout)
    batches = SceneBatches(source, training, config.batches, seed=config.seed)
    validation = {
        views: [s.to(config.device) for s in validation_samples(source, held_out, views)]
        for views in config.validation_views
    }
    log = RunLog(folder, total_steps=config.steps, first_step=state.step)
    log.say(
        f"{len(training)} scenes to train on, {len(held_out)} held out, "
        f"{sum(p.numel() for p in state.model.parameters() if p.requires_grad) / 1e6:.2f} M "
        f"trained parameters, step {state.step} of {config.steps}"
    )

    start = last_validation = last_save = time.monotonic()
    elapsed_before_s = state.elapsed_s
    sums = RunningMeans()
    with stop_requests() as requests:
        for step, sample in batches.iterate(state.step):
            now = time.monotonic()
            state.elapsed_s = elapsed_before_s + now - start
            reason = _end(config, step, now - start, time_limit_min, bool(requests))

            # Validate and draw, also before the first step and at the end, on averaged weights.
            due = now - last_validation >= config.validate_every_s
            if step == 0 or (reason and reason != "interrupted") or due or (
                config.validate_every_steps and step % config.validate_every_steps == 0
            ):  # fmt: skip
                figures = validate(config, stage, state, validation, folder)
                log.validation(step, state.elapsed_s, figures)
                plot_curves(log.path, folder / "curves.png")
                last_validation = time.monotonic()
                log.pause(last_validation - now)

            # Save.
            before_save = time.monotonic()
            due = before_save - last_save >= config.checkpoint_every_s
            if reason or due or (
                config.checkpoint_every_steps and step and step % config.checkpoint_every_steps == 0
            ):  # fmt: skip
                save_checkpoint(folder, state, to_json(config))
                last_save = time.monotonic()
                log.pause(last_save - before_save)
            if reason:
                log.say(f"{reason} at step {step}")
                return TrainOutcome(step, reason)

            # Step.
            rate = learning_rate(
                step,
                peak=config.lr,
                warmup_steps=config.warmup_steps,
                cosine_steps=config.cosine_steps or config.steps,
                final_fraction=config.final_lr_fraction,
            )
            figures = train_step(config, stage, state, sample.to(config.device), rate, folder)
            state.step += 1

            # Log.
            sums.add(figures)
            if state.step % config.log_every_steps == 0 or state.step == config.steps:
                log.train(state.step, state.elapsed_s, sums.take() | {"lr": rate})
    raise AssertionError("batches never end")


@torch.no_grad()
def validate(
    config: TrainConfig,
    stage: Stage,
    state: RunState,
    samples: dict[int, list[Sample]],
    folder: Path,
) -> dict[str, float]:
    """Figures of the averaged weights on the held-out samples, and RUN/pictures/step_N.png.

    With several protocols, their figures are told apart by a prefix. Leaves the RNG as it was.
    """
    figures: dict[str, float] = {}
    device = next(state.model.parameters()).device.type
    average = state.average if config.ema_decay else WeightAverage(state.model, 0.0)
    state.model.eval()
    with (
        torch.random.fork_rng(),
        average.applied(state.model),
        torch.autocast(device, torch.bfloat16, enabled=config.amp),
    ):
        for views, batches in samples.items():
            prefix = f"{views}views_" if len(samples) > 1 else ""
            found = stage.validate(state.model, batches)
            figures |= {prefix + name: value for name, value in found.items()}
        first = next(iter(samples.values()))[0]
        picture = stage.pictures(state.model, first)
    state.model.train()
    path = folder / "pictures" / f"step_{state.step:08d}.png"
    path.parent.mkdir(exist_ok=True)
    with replacing(path) as part:
        picture.save(part)
    return figures


@contextmanager
def stop_requests() -> Iterator[list[int]]:
    """A list that grows when SIGINT or SIGTERM arrives; the second signal acts as usual."""
    requests: list[int] = []

    def note(number: int, _frame: object) -> None:
        requests.append(number)
        for each, handler in before.items():
            signal.signal(each, handler)

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        signal.signal(number, note)
    try:
        yield requests
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _end(
    config: TrainConfig, step: int, spent_s: float, time_limit_min: float | None, stopped: bool
) -> Literal["finished", "time limit", "interrupted"] | None:
    if step >= config.steps:
        return "finished"
    if stopped:
        return "interrupted"
    if time_limit_min is not None and spent_s >= 60 * time_limit_min:
        return "time limit"
    return None
