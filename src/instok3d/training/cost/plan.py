"""What a run would do and take, printed without doing it: `instok3d train ... --dry-run`."""

from dataclasses import dataclass
from pathlib import Path

from instok3d.data.scenes import SceneSource
from instok3d.data.view_sampling import frames_needed
from instok3d.errors import MissingWeightsError
from instok3d.training.config import TrainConfig
from instok3d.training.cost.estimate import (
    PEAK_TFLOPS,
    UTILISATION,
    Part,
    disk_bytes,
    flop_per_batch,
    hours,
    model_on_paper,
    parts_of,
    samples_per_batch,
    targets_of,
    training_memory_bytes,
)
from instok3d.training.cost.scene_check import check_scenes
from instok3d.training.cost.wanted_data import how_to_get_scenes, wanted_scenes
from instok3d.training.schedule import learning_rate
from instok3d.training.stages.answers import NeededWeights
from instok3d.weights import weights_path

PAPER_BATCH = 32


@dataclass(frozen=True)
class Plan:
    """A run, counted."""

    stage: str
    data: "PlannedScenes | None"
    """None where there are no scenes yet."""
    wanted_data: str
    """What the scenes have to be."""
    height: int
    width: int
    views: tuple[int, ...]
    targets: int
    steps: int
    samples_per_process: float
    """In a batch, the mean over the numbers of views."""
    accumulate: int
    processes: int
    parts: tuple[Part, ...]
    flop_per_update: float
    hours: float | None
    """None where the device is no GPU."""
    memory_bytes: int
    """Peak of one process."""
    disk_bytes: int
    rates: tuple[tuple[int, float], ...]
    """Learning rates at some steps."""
    missing: tuple[str, ...]
    """What the run lacks, and how to get it."""

    @property
    def samples_per_update(self) -> float:
        """Batch x accumulate x processes."""
        return self.samples_per_process * self.accumulate * self.processes

    @property
    def samples(self) -> float:
        """Of the whole run."""
        return self.steps * self.samples_per_update


@dataclass(frozen=True)
class PlannedScenes:
    """The scenes of a run, counted."""

    scenes: int
    """That are trained on."""
    held_out: int
    too_short: int
    """Scenes with fewer frames than a sample needs; they are left out."""
    frames: int
    """Of the scenes that are trained on."""


def make_plan(
    config: TrainConfig,
    source: SceneSource | None,
    *,
    num_gpus: int,
    gpu: str,
    init_from: Path | None,
    resume: bool = False,
) -> Plan:
    """Count a run; reads a few frames, needs no weights and no scenes, writes nothing.

    Args:
        config: Its settings.
        source: Its scenes; without any, pictures are taken to be of the backbone's own size.
        num_gpus: Processes, one for each GPU.
        gpu: One of PEAK_TFLOPS.
        init_from: As it would be given to the run.
        resume: First weights are not needed then.

    Raises:
        ValueError: The data set lacks what the stage needs, or there is no such GPU.
    """
    if num_gpus < 1:
        raise ValueError(f"the number of processes must be at least 1, got {num_gpus}")
    batches, views = config.batches, max(config.batches.views)
    data, height, width = None, config.stage.picture_side(), config.stage.picture_side()
    if source is not None:
        height, width = check_scenes(config, source)
        data = _counted(config, source)
    model = model_on_paper(config)
    samples = [samples_per_batch(config, each) for each in batches.views]
    flop = flop_per_batch(config, model, height, width) * config.accumulate * num_gpus
    on_gpu = config.device != "cpu"
    return Plan(
        stage=config.stage.name,
        data=data,
        wanted_data=wanted_scenes(config),
        height=height,
        width=width,
        views=tuple(sorted(set(batches.views))),
        targets=targets_of(config, views),
        steps=config.steps,
        samples_per_process=sum(samples) / len(samples),
        accumulate=config.accumulate,
        processes=num_gpus,
        parts=tuple(parts_of(model)),
        flop_per_update=flop,
        hours=hours(flop * config.steps, num_gpus=num_gpus, gpu=gpu) if on_gpu else None,
        memory_bytes=training_memory_bytes(config, model, height, width),
        disk_bytes=disk_bytes(model, averaged=config.ema_decay > 0),
        rates=tuple((step, _rate(config, step)) for step in _steps_to_show(config)),
        missing=tuple(
            ([] if source is not None else [f"scenes to train on: {how_to_get_scenes(config)}"])
            + _missing(config, init_from, resume)
        ),
    )


def _counted(config: TrainConfig, source: SceneSource) -> PlannedScenes:
    counts = [source.num_frames(number) for number in range(len(source))]
    training = counts[config.holdout :]
    needed = frames_needed(max(config.batches.views), config.batches.sampling)
    kept = [count for count in training if count >= needed]
    if not kept:
        raise ValueError(
            f"no scene is left to train on: {len(counts)} scenes, {config.holdout} held out, of "
            f"the rest {len(training)} have fewer than {needed} frames; lower --holdout or "
            "prepare more scenes"
        )
    return PlannedScenes(
        scenes=len(kept),
        held_out=min(config.holdout, len(counts)),
        too_short=len(training) - len(kept),
        frames=sum(kept),
    )


def plan_text(plan: Plan, *, gpu: str) -> str:
    """The plan as lines of text."""
    each = " or ".join(map(str, plan.views))
    frozen = [f"{p.name} {p.frozen / 1e6:.2f} M" for p in plan.parts if p.frozen > 5000]
    trained = [f"{p.name} {p.trained / 1e6:.2f} M" for p in plan.parts if p.trained > 5000]
    update = plan.samples_per_update
    paper = f" (the paper: {PAPER_BATCH})" if plan.hours and update != PAPER_BATCH else ""
    lines = {
        "stage": plan.stage,
        "scenes": _scenes_text(plan),
        "sample": f"{each} context views, {plan.targets} targets of {plan.height} x {plan.width}",
        "update": f"{update:.4g} samples = {plan.samples_per_process:.4g} in a batch x "
        f"{plan.accumulate} accumulated x {plan.processes} processes{paper}",
        "steps": f"{plan.steps} updates, {plan.samples:.0f} samples"
        + (f", {plan.samples / plan.data.scenes:.1f} of each scene" if plan.data else ""),
        "learning rate": ", ".join(f"{rate:.1e} at {step}" for step, rate in plan.rates),
        "trained": f"{sum(p.trained for p in plan.parts) / 1e6:.2f} M parameters: "
        + ", ".join(trained),
        "frozen": f"{sum(p.frozen for p in plan.parts) / 1e6:.2f} M parameters"
        + (f": {', '.join(frozen)}" if frozen else ""),
        "work": f"{plan.flop_per_update / 1e12:.3g} TFLOP an update "
        "(2 x parameters x patches, x 3 where they learn)",
        "time": _time_text(plan, gpu),
        "memory": f"about {plan.memory_bytes / 1e9:.1f} GB a process",
        "disk": f"{plan.disk_bytes / 1e9:.1f} GB of checkpoints",
        "missing": "; ".join(plan.missing) or "nothing",
    }
    return "\n".join(f"{name:14} {text}" for name, text in lines.items())


def _scenes_text(plan: Plan) -> str:
    data = plan.data
    if data is None:
        return f"none yet; needed are {plan.wanted_data}"
    short = f", {data.too_short} too short" if data.too_short else ""
    return f"{data.scenes} to train on with {data.frames} frames, {data.held_out} held out{short}"


def _time_text(plan: Plan, gpu: str) -> str:
    if plan.hours is None:
        return "not estimated on a CPU; the first console lines of a run tell it"
    return (
        f"about {plan.hours:.1f} hours on {plan.processes} {gpu} (work / ({PEAK_TFLOPS[gpu]:.0f} "
        f"TFLOP/s x {UTILISATION:.0%} of it reached, as in the paper's runs)), within a factor of 2"
    )


def _steps_to_show(config: TrainConfig) -> list[int]:
    end = config.cosine_steps or config.steps
    steps = {0, config.warmup_steps, (config.warmup_steps + end) // 2, config.steps - 1}
    return sorted(step for step in steps if 0 <= step < config.steps)


def _rate(config: TrainConfig, step: int) -> float:
    return learning_rate(
        step,
        peak=config.lr,
        warmup_steps=config.warmup_steps,
        cosine_steps=config.cosine_steps or config.steps,
        final_fraction=config.final_lr_fraction,
    )


def _missing(config: TrainConfig, init_from: Path | None, resume: bool) -> list[str]:
    first, begun = config.stage.first_weights(), bool(init_from or resume)
    needed = list(config.stage.other_weights())
    if first.published and not begun:
        needed.insert(0, NeededWeights("the first weights", first.published))
    missing = [text for each in needed if (text := _missing_weights(each))]
    if first.wanted and not (first.published or begun):
        missing.append(f"{first.wanted}: give the run that made it with --init-from")
    if init_from is not None and not init_from.exists():
        missing.append(f"no run folder and no .safetensors file at {init_from}")
    return missing


def _missing_weights(needed: NeededWeights) -> str | None:
    if isinstance(needed.where, Path):
        return None if needed.where.is_file() else f"no {needed.what} weights at {needed.where}"
    try:
        weights_path(needed.where)
    except MissingWeightsError as error:
        return str(error)
    return None
