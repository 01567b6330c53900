"""`instok3d tables`: the paper's tables on rooms or the paper's data, by one command."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

if TYPE_CHECKING:
    from instok3d.tables.work import Work

TableName = Literal["1", "2", "3", "4", "5", "6", "7", "8", "all"]


def run(
    numbers: Positional[tuple[TableName, ...]] = ("all",),
    *,
    data: tuple[Path, ...],
    output: Annotated[Path, arg(aliases=["-o"])],
    captures: Path | None = None,
    index: Path | None = None,
    quick: bool = False,
    resume: bool = False,
    dry_run: bool = False,
    steps: int | None = None,
    seed: int = 0,
    scenes: int | None = None,
    masks: tuple[Literal["segmenter", "degraded", "true"], ...] = ("segmenter", "degraded", "true"),
    tracker: Literal["true-depth", "predicted-depth", "flow2d", "none"] | None = None,
    method_steps: int | None = None,
    model: str | None = None,
    semantics: Path | None = None,
    segmenter: Path | None = None,
    backbone: Path | None = None,
    teacher: str | None = None,
    lpips: str | None = None,
    threads: int | None = None,
) -> None:
    """Train what the paper's tables need, measure it, write Markdown, LaTeX, JSON and figures.

    Everything lies in the output folder. Stop the command at any time and give it again with
    --resume: trainings go on from their checkpoints, scenes that were measured stay measured.

    Args:
        numbers: Which tables: 1 to 6 as in the paper, 7 and 8 of our own deviations from it; all by
            default.
        data: Folders of rooms to train on (seeds from 0), to test on (from 2000000) and, for
            Table 6, of transfer rooms (from 3000000). Or prepared folders: ScanNet, for Table 5
            RealEstate10K with masks of SAM 2, for Table 6 MipNeRF360 (instok3d data prepare).
        output: Folder of the tables.
        captures: A folder of captures of real rooms for Table 6 on rooms.
        index: The evaluation index of RealEstate10K, a JSON file, for Table 5 on that data set.
        quick: Toy sizes and two scenes: shows that all parts fit together, and nothing else.
        resume: Go on in a folder that holds tables.
        dry_run: Print what would be trained and measured, and the hours; write nothing.
        steps: Updates of the tokenizer's training, 3000 by default; other trainings have as many as
            fit in its time.
        seed: Of the trainings.
        scenes: Measure the first so many of each set of rooms alone.
        masks: That the methods of Table 2 are given, a row for each (docs/evaluation.md).
        tracker: How ids of masks that are not true come to hold across views. By default
            predicted-depth for those of the segmenter, true-depth for degraded ones.
        method_steps: Of the methods that optimise each scene; their own by default.
        model: Measure this model's file, or "default", as ours in Tables 1, 2, 4, 6 and 8 instead
            of one that is trained here by the same steps as its rivals.
        semantics: Of that model; those of the default model come with it, others are trained.
        segmenter: Take the masks of this segmenter's file instead of training one.
        backbone: A run or file whose backbone all trainings begin with; the default model's.
        teacher: 2D encoder whose features are lifted, such as lseg:FILE; the one that comes with
            instok3d by default.
        lpips: vgg or alex after 'instok3d models pull lpips', or a file; without it there is no
            column of LPIPS.
        threads: Of each training; as PyTorch chooses by default.
    """
    from instok3d.tables.definitions import tables, without_lpips
    from instok3d.tables.plan import make_plan, plan_text
    from instok3d.tables.run import make_tables

    if steps is not None and steps < 1:
        raise ValueError(f"--steps must be at least 1, got {steps}")
    if scenes is not None and scenes < 1:
        raise ValueError(f"--scenes must be at least 1, got {scenes}")
    if semantics is not None and model is None:
        raise ValueError("--semantics is of a given model: name it with --model")
    work = _work(
        data, output, captures, index, quick, steps, seed, scenes, method_steps, model, semantics,
        segmenter, backbone, teacher, lpips, threads,
    )  # fmt: skip
    known = tables(masks, tracker, work.schedule.of)
    asked = [known[n] for n in known if "all" in numbers or str(n) in numbers]
    if lpips is None:
        asked = [without_lpips(table) for table in asked]
    if dry_run:
        print(plan_text(make_plan(work, asked)))
        return
    for path in make_tables(work, asked, resume=resume):
        print(path)


def _work(
    data: tuple[Path, ...],
    output: Path,
    captures: Path | None,
    index: Path | None,
    quick: bool,
    steps: int | None,
    seed: int,
    scenes: int | None,
    method_steps: int | None,
    model: str | None,
    semantics: Path | None,
    segmenter: Path | None,
    backbone: Path | None,
    teacher: str | None,
    lpips: str | None,
    threads: int | None,
) -> "Work":
    """What the command line says, with what it leaves to a rule."""
    from instok3d.model.files import DEFAULT_MODEL
    from instok3d.objectives.lpips import load_lpips
    from instok3d.semantics.query.shipped import SHIPPED
    from instok3d.semantics.teachers.opening import open_teacher
    from instok3d.tables.data_sets import tables_of
    from instok3d.tables.trainings import QUICK_STEPS, Schedule
    from instok3d.tables.work import Work

    rule = QUICK_STEPS if quick else 3000
    is_default = model == "default"
    of = tables_of(data)
    if captures is not None and of != "rooms":
        raise ValueError("--captures is of Table 6 on rooms: leave it out for prepared scenes")
    if index is not None and of == "rooms":
        raise ValueError("--index is of RealEstate10K: leave it out for rooms")
    return Work(
        folder=output,
        data=data,
        schedule=Schedule(
            steps=rule if steps is None else steps,
            seed=seed,
            quick=quick,
            teacher=teacher or f"rooms:{SHIPPED}",
            channels=Schedule.channels if teacher is None else open_teacher(teacher).channels,
            threads=threads,
            of=of,
        ),
        num_scenes=scenes,
        captures=captures,
        re10k_index=index,
        backbone=backbone or DEFAULT_MODEL,
        model=None if model is None else DEFAULT_MODEL if is_default else Path(model),
        semantics=SHIPPED if is_default and semantics is None else semantics,
        segmenter=segmenter,
        method_steps=method_steps,
        lpips=None if lpips is None else load_lpips(lpips),
        command=" ".join(["instok3d", *sys.argv[1:]]),
    )
