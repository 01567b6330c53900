"""What the command would do, counted before it is done."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from instok3d.tables.cells import Asked, asked_of, cell_path
from instok3d.tables.definitions import OnePass, PerScene, Table, Tokenizer, Views
from instok3d.tables.trained import file_of, is_trained
from instok3d.tables.trainings import JOINT, OURS, TRAININGS, config_of, needed
from instok3d.tables.work import Work

FEATURES_S, ONE_PASS_S, REFINED_S, PER_SCENE_S = 6.0, 1.5, 12.0, 26.0
TOKENIZER_S: dict[Views, float] = {2: 1.5, 8: 5.0}
"""For a scene of 128 x 128 pixels on one core, about."""
QUICK_S = 2.0
"""Of a step at toy sizes."""


@dataclass(frozen=True)
class Step:
    """One training, or one cell."""

    what: str
    training: str | None
    asked: Asked | None
    done: bool
    hours: float
    """That it takes, about; 0 where it is done."""


@dataclass(frozen=True)
class TablesPlan:
    """All that is to be done, in its order."""

    steps: tuple[Step, ...]
    missing: tuple[str, ...] = ()
    """Scenes that are not there, each with what makes them."""

    @property
    def hours(self) -> float:
        """Of what is not done."""
        return sum((step.hours for step in self.steps), 0.0)


def make_plan(work: Work, tables: Sequence[Table]) -> TablesPlan:
    """The trainings that some tables take, then the cells; equal cells of two tables are one.

    Raises:
        FileNotFoundError: A given model is not there.
        ValueError: Rooms or captures cannot be used.
    """
    wanted = [(table, each) for table in tables for _, cells in asked_of(table) for each in cells]
    asked, missing = _with_scenes(work, wanted)
    names = list(dict.fromkeys(name for _, each in asked for name in each.trainings))
    order = needed(names, [name for name in names if file_of(work, name) is not None])
    try:
        for name in order:
            work.training_digest(name)
    except FileNotFoundError as error:
        return TablesPlan((), (str(error), *missing))
    return TablesPlan(
        missing=tuple(missing),
        steps=(*(_training(work, name) for name in order), *_cells(work, asked)),
    )


def _with_scenes(
    work: Work, wanted: Sequence[tuple[Table, Asked]]
) -> tuple[list[tuple[Table, Asked]], list[str]]:
    """The cells whose scenes are there, and what is missing for the others."""
    found, missing = [], []
    for table, asked in wanted:
        try:
            work.scenes(asked.row.scenes, asked.views)
            found.append((table, asked))
        except FileNotFoundError as error:
            missing.append(str(error))
    return found, list(dict.fromkeys(missing))


def _training(work: Work, name: str) -> Step:
    config = config_of(name, work.schedule)
    done = is_trained(work, name)
    seconds = QUICK_S if work.schedule.quick else config.steps * TRAININGS[name].update_s
    hours = 0.0 if done else seconds / 3600
    masks = f", masks {config.masks}" if config.masks else ""
    return Step(f"train {name}: {config.steps} updates{masks}", name, None, done, hours)


def _cells(work: Work, asked: Sequence[tuple[Table, Asked]]) -> list[Step]:
    steps: list[Step] = []
    seen: set[object] = set()
    for table, each in asked:
        method = each.method
        if isinstance(method, Tokenizer) and method.training == OURS and work.model is None:
            method = replace(method, training=JOINT)
        same = (each.of, method, each.row.scenes, each.views)
        if same in seen:
            continue
        seen.add(same)
        count = len(work.scenes(each.row.scenes, each.views).names)
        done = _is_there(work, each) and cell_path(work, each).is_file()
        label = each.row.label if each.method else "features of all kinds"
        if each.of == "features" and each.method:
            label = f"{label}, features"
        seconds = QUICK_S if work.schedule.quick else count * _scene_s(each)
        what = f"measure Table {table.number}, {label}: {count} scenes"
        steps.append(Step(what, None, each, done, 0.0 if done else seconds / 3600))
    return steps


def _is_there(work: Work, asked: Asked) -> bool:
    """Whether all models that a cell needs are trained."""
    return all(
        file_of(work, name) is not None or is_trained(work, JOINT if name == OURS else name)
        for name in asked.trainings
    )


def _scene_s(asked: Asked) -> float:
    if asked.of == "features":
        return FEATURES_S
    method = asked.row.method
    if isinstance(method, PerScene):
        return PER_SCENE_S
    if isinstance(method, OnePass):
        return ONE_PASS_S
    assert isinstance(method, Tokenizer)
    return REFINED_S if method.refine else TOKENIZER_S[asked.views]


def plan_text(plan: TablesPlan) -> str:
    """A line for each step, what is missing, and the sum."""
    lines = [
        f"{'done' if step.done else f'{step.hours:.2f} h':>8}  {step.what}" for step in plan.steps
    ]
    lines += [f"{'missing':>8}  {each}" for each in plan.missing]
    left = sum(not step.done for step in plan.steps)
    lines.append(
        f"{left} of {len(plan.steps)} steps are left, about {plan.hours:.1f} hours on one core at "
        "128 x 128 pixels"
    )
    return "\n".join(lines)
