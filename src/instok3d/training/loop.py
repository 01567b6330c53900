"""The training loop, read from top to bottom: validate, picture, save, step, log.

With several processes all of them run it. What depends on a clock or a signal is decided together
before each step, so that none waits for another; the first one validates, writes and speaks.
"""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from torch import nn

from instok3d.data.batches import SceneBatches
from instok3d.data.sample import Sample
from instok3d.data.scenes import SceneSource
from instok3d.files import replacing
from instok3d.locking import alone_in, remove_leftovers
from instok3d.reading import reason_of
from instok3d.training.checkpoint import (
    RunState,
    has_checkpoint,
    read_checkpoint,
    read_weights,
    restore,
    restore_weights,
    save_checkpoint,
)
from instok3d.training.config import TrainConfig, to_json, write_config
from instok3d.training.credits import keep_credits
from instok3d.training.distributed import Processes, joined_processes, share, whole
from instok3d.training.held_out import split_scenes, validation_samples
from instok3d.training.plots import plot_curves
from instok3d.training.run_log import RunLog, RunningMeans
from instok3d.training.schedule import learning_rate
from instok3d.training.stages.stage import Stage
from instok3d.training.update import new_state, train_step
from instok3d.version import current_commit

LOCK = ".lock"
"""Held by the process that writes a run's folder."""

End = Literal["finished", "time limit", "interrupted"]


@dataclass(frozen=True)
class TrainOutcome:
    """How a run ended."""

    step: int
    reason: End


@dataclass(frozen=True)
class Run:
    """All that a run works with; what changes is in its state."""

    config: TrainConfig
    stage: Stage
    folder: Path
    processes: Processes
    state: RunState
    loss: nn.Module
    """See `distributed.share`."""
    batches: SceneBatches
    validation: dict[int, list[Sample]]
    """Samples by their number of views; none but in the first process."""


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

    Started by torchrun, the processes share the work. SIGINT and SIGTERM in any of them end the
    run after the update in hand, with a checkpoint; a second one ends it at once.

    Args:
        config: Settings; on resuming they must be those of the run except where it ends.
        stage: What is trained, built from config.stage.
        source: Scenes. The run uses those that are there when it starts, also after resuming.
        folder: The run; on a disk that all machines see.
        resume: Go on from the newest checkpoint; bit for bit as if it had not stopped.
        add_scenes: On resuming, also use the scenes that the data set has gained since; the run is
            then a new one from here on. The held-out scenes stay the same.
        init_from: A run folder or .safetensors file to take first weights from.
        time_limit_min: Stop with a checkpoint after this many minutes of this call.

    Raises:
        ValueError: The folder holds a run and resume is off, another process is at work in it, the
            data set is too small, or the first weights do not fit.
        FileNotFoundError: Nothing to resume.
        NonFiniteLossError: Training diverged.
    """
    if config.threads:
        torch.set_num_threads(config.threads)
    with joined_processes(config.device) as processes, _alone(folder, processes):
        run = _prepared(config, stage, source, folder, processes, resume, add_scenes, init_from)
        log = RunLog(
            folder if processes.is_first else None,
            total_steps=config.steps,
            first_step=run.state.step,
            resumed=resume,
        )
        with stop_requests() as requests, log.showing():
            return _steps(run, log, requests, time_limit_min)


@contextmanager
def _alone(folder: Path, processes: Processes) -> Iterator[None]:
    """Hold the run's folder in the first process, which alone writes."""
    if not processes.is_first:
        yield
        return
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with alone_in(folder / LOCK, f"another process is at work in the run {folder}; wait"):
            yield
    finally:
        if made and not any(folder.iterdir()):  # of a run that was refused nothing is left
            folder.rmdir()


def _prepared(
    config: TrainConfig,
    stage: Stage,
    source: SceneSource,
    folder: Path,
    processes: Processes,
    resume: bool,
    add_scenes: bool,
    init_from: Path | None,
) -> Run:
    """The run as it stands before its next step."""
    torch.manual_seed(config.seed)  # the same first weights in all processes
    model = stage.build_model()
    names = [source.name_of(number) for number in range(len(source))]
    checkpoint = read_checkpoint(folder) if resume else None
    if checkpoint is not None:
        restore_weights(model, checkpoint)
    elif has_checkpoint(folder):
        raise ValueError(f"{folder} holds a run: pass --resume to go on or choose another folder")
    elif init_from is not None:
        try:
            stage.load_initial(model, read_weights(init_from))
        except RuntimeError as error:
            raise ValueError(
                f"{init_from} does not fit the sizes of this run: {reason_of(error)}"
            ) from error
    model.to(processes.device(config.device))
    loss = share(stage, model, processes, config.strategy)
    state = new_state(config, model)
    state.scene_names = names
    if processes.rank:
        torch.manual_seed(config.seed + processes.rank)  # dropout of its own
    if checkpoint is not None:
        restore(state, checkpoint, processes)
        if add_scenes:
            known = set(state.scene_names)
            state.scene_names += [name for name in names if name not in known]
    held_out, training = split_scenes(source, state.scene_names, config.holdout)
    batches = SceneBatches(
        source,
        training,
        config.batches,
        seed=config.seed,
        rank=processes.rank,
        world_size=processes.count,
        accumulate=config.accumulate,
    )
    validation = {}
    if processes.is_first:
        for place in (folder, folder / "checkpoints", folder / "pictures"):
            remove_leftovers(place)
        write_config(folder, config, commit=current_commit())
        keep_credits(folder, source, resume=resume, init_from=init_from)
        for views in config.validation_views:
            validation[views] = validation_samples(source, held_out, views)
            height, width = validation[views][0].context.images.shape[-2:]
            state.image_size = (height, width)
    return Run(config, stage, folder, processes, state, loss, batches, validation)


def _steps(
    run: Run, log: RunLog, requests: list[int], time_limit_min: float | None
) -> TrainOutcome:
    config, state, folder, processes = run.config, run.state, run.folder, run.processes
    log.say(_beginning(run))
    start = last_validation = last_save = time.monotonic()
    elapsed_before_s = state.elapsed_s
    sums = RunningMeans()
    for step, parts in run.batches.iterate(state.step, config.readers):
        now = time.monotonic()
        state.elapsed_s = elapsed_before_s + now - start
        out_of_time = time_limit_min is not None and now - start >= 60 * time_limit_min
        stopped, out_of_time, validation_due, save_due = processes.any(
            bool(requests),
            processes.is_first and out_of_time,
            processes.is_first and now - last_validation >= config.validate_every_s,
            processes.is_first and now - last_save >= config.checkpoint_every_s,
        )
        reason = _end(step >= config.steps, stopped, out_of_time)

        # Validate and draw, also before the first step and at the end, on averaged weights.
        ending = reason is not None and reason != "interrupted"
        if step == 0 or ending or validation_due or _is_turn(step, config.validate_every_steps):
            log.working(f"validating on {config.holdout} scenes")
            with averaged_model(run) as model:
                if model is not None:
                    log.validation(step, state.elapsed_s, validate(run, model))
                    plot_curves(folder / "metrics.jsonl", folder / "curves.png")
            last_validation = time.monotonic()
            log.pause(last_validation - now)

        # Save.
        before_save = time.monotonic()
        if reason or save_due or (step and _is_turn(step, config.checkpoint_every_steps)):
            log.working("saving")
            save_checkpoint(folder, state, to_json(config), processes)
            last_save = time.monotonic()
            log.pause(last_save - before_save)
        if reason:
            log.say(f"{reason} at step {step}")
            return TrainOutcome(step, reason)

        # Step.
        log.stepping(step)
        rate = learning_rate(
            step,
            peak=config.lr,
            warmup_steps=config.warmup_steps,
            cosine_steps=config.cosine_steps or config.steps,
            final_fraction=config.final_lr_fraction,
        )
        sums.add(train_step(config, run.loss, state, parts, rate, folder, processes))
        state.step += 1

        # Log the means over steps and processes.
        if state.step % config.log_every_steps == 0 or state.step == config.steps:
            over_processes = RunningMeans()
            for means in processes.gather(sums.take()):
                over_processes.add(means)
            log.train(state.step, state.elapsed_s, over_processes.take() | {"lr": rate})
    raise AssertionError("batches never end")


@contextmanager
def averaged_model(run: Run) -> Iterator[nn.Module | None]:
    """The model with averaged weights, for validation; None in all processes but the first.

    Shards are gathered into a model of its own. Leaves the RNG as it was.
    """
    config, state, processes = run.config, run.state, run.processes
    device = torch.device(processes.device(config.device))
    with torch.random.fork_rng([device] if device.type == "cuda" else []):
        if config.strategy == "fsdp" and processes.count > 1:
            averaged = {**state.model.state_dict(), **state.average.values}
            weights = whole(averaged, keep=processes.is_first)
            if not processes.is_first:
                yield None
                return
            model = run.stage.build_model().to(device)
            model.load_state_dict(weights)
            yield model.eval()
        elif processes.is_first:
            with state.average.applied(state.model):
                yield state.model.eval()
            state.model.train()
        else:
            yield None


@torch.no_grad()
def validate(run: Run, model: nn.Module) -> dict[str, float]:
    """Figures of a model on the held-out samples, and RUN/pictures/step_N.png.

    With several protocols, a prefix distinguishes their figures.
    """
    figures: dict[str, float] = {}
    device = run.processes.device(run.config.device)
    with torch.autocast(torch.device(device).type, torch.bfloat16, enabled=run.config.amp):
        for views, samples in run.validation.items():
            prefix = f"{views}views_" if len(run.validation) > 1 else ""
            found = run.stage.validate(model, [sample.to(device) for sample in samples])
            figures |= {prefix + name: value for name, value in found.items()}
        first = next(iter(run.validation.values()))[0]
        picture = run.stage.pictures(model, first.to(device))
    path = run.folder / "pictures" / f"step_{run.state.step:08d}.png"
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


def _beginning(run: Run) -> str:
    trained = sum(p.numel() for p in run.state.model.parameters() if p.requires_grad)
    count = run.processes.count
    return (
        f"{len(run.batches.scenes)} scenes to train on, {run.config.holdout} held out, "
        f"{trained / 1e6:.2f} M trained parameters, {count} process{'es' * (count > 1)}, "
        f"step {run.state.step} of {run.config.steps}"
    )


def _end(finished: bool, stopped: bool, out_of_time: bool) -> End | None:
    if finished:
        return "finished"
    if stopped:
        return "interrupted"
    return "time limit" if out_of_time else None


def _is_turn(step: int, every_steps: int) -> bool:
    return bool(every_steps) and step % every_steps == 0
