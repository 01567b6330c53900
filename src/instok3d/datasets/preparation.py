"""Preparing many scenes: how much disk they take, several processes, resuming, counting failures.

A reader of a data set only lists its scenes as `SceneJob`; everything else happens here.
"""

import errno
import json
import multiprocessing
import os
import shutil
import signal
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Protocol

from instok3d.datasets.prepared import (
    DroppedFrame,
    PreparedFrame,
    SceneInfo,
    read_scene,
    refresh_index,
    write_scene,
)
from instok3d.datasets.prepared.format import RECORD
from instok3d.locking import alone_in, remove_leftovers
from instok3d.progress import progress_bar
from instok3d.reading import UNREADABLE

LOCK = ".lock"
"""Held by the run that prepares scenes into a folder."""
FULL_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
BYTES_PER_PIXEL = {"images": 1.6, "depths": 1.2, "instances": 0.05, "labels": 0.05}
"""Of the PNG files of indoor scenes, rounded up."""

SPLIT_RULE = "split_rule"
"""The setting that says how a scene came to its split; it may change between runs."""

Frames = Iterable[PreparedFrame | DroppedFrame]


class LeftOutError(ValueError):
    """A scene that is not wanted, such as one of another picture size; no failure."""


@dataclass(frozen=True)
class SceneJob:
    """One scene that can be prepared, here or in another process."""

    info: SceneInfo
    estimated_bytes: int
    """What it will take on the disk."""
    frames: Callable[[], Frames]
    """Reads the scene; must be picklable (a module's function, or a `partial` of one). Raises
    LeftOutError for a scene that is not wanted."""


class PreparationSource(Protocol):
    """A data set in its original form."""

    def jobs(self) -> Sequence[SceneJob]:
        """All its scenes; only listings and headers are read."""
        ...


@dataclass(frozen=True)
class PreparationPlan:
    """What is to be done in a folder."""

    folder: Path
    jobs: tuple[SceneJob, ...]
    """Not yet done."""
    skipped: int
    """Scenes that are there already."""
    free_bytes: int
    """On the disk of the folder."""

    @property
    def estimated_bytes(self) -> int:
        """What the jobs will take together."""
        return sum(job.estimated_bytes for job in self.jobs)


@dataclass
class PreparationReport:
    """What came of a plan; grows while it runs."""

    scenes: int = 0
    """Newly prepared."""
    frames: int = 0
    num_bytes: int = 0
    skipped: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    """Frames that were left out of the new scenes, by reason."""
    left_out: Counter[str] = field(default_factory=Counter)
    """Scenes that are not wanted, by reason; looked at again by the next run."""
    failed: dict[str, str] = field(default_factory=dict)
    """Why each scene that could not be prepared could not."""


@dataclass(frozen=True)
class _Outcome:
    frames: int = 0
    num_bytes: int = 0
    dropped: dict[str, int] = field(default_factory=dict)
    left_out: str | None = None
    failure: str | None = None


def estimate_bytes(num_frames: int, height: int, width: int, layers: Sequence[str]) -> int:
    """About how much the pictures of a scene take, for `SceneJob`.

    Args:
        num_frames: Of the prepared scene.
        height: Of each.
        width: Of each.
        layers: Of images, depths, instances, labels.
    """
    per_pixel = sum(BYTES_PER_PIXEL[layer] for layer in layers)
    return int(num_frames * (height * width * per_pixel + 1000 + 200 * len(layers)))


def plan_preparation(jobs: Sequence[SceneJob], folder: Path) -> PreparationPlan:
    """What is left to do and whether it fits; reads the records of scenes that are there.

    Args:
        jobs: All scenes of a source.
        folder: The prepared folder; need not be there yet.

    Raises:
        NotADirectoryError: The folder is a file.
        ValueError: There are no scenes, two have one name, or a scene is there that was prepared
            with other settings.
    """
    if not jobs:
        raise ValueError("there is no scene to prepare")
    twice = [name for name, count in Counter(job.info.name for job in jobs).items() if count > 1]
    if twice:
        raise ValueError(f"several scenes have the same name: {', '.join(twice[:5])}")
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"cannot prepare scenes into {folder}: it is a file")
    missing = tuple(job for job in jobs if not _is_done(job.info, folder))
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    free = shutil.disk_usage(there).free
    return PreparationPlan(folder, missing, len(jobs) - len(missing), free)


def prepare(plan: PreparationPlan, *, workers: int = 2, progress: bool = True) -> PreparationReport:
    """Prepare all scenes of a plan; one that fails is reported and the others go on.

    It can be stopped at any time: scenes appear whole, and a new plan holds the rest. One run at a
    time may prepare scenes into a folder.

    Args:
        plan: Of `plan_preparation`.
        workers: Processes.
        progress: Each failure on stderr as it comes, and a bar where that is a terminal.

    Raises:
        OSError: The disk is or would become full (errno ENOSPC).
        ValueError: workers is below 1, or another run is preparing into the folder.
    """
    if workers < 1:
        raise ValueError(f"workers must be 1 or more, got {workers}")
    if plan.estimated_bytes > plan.free_bytes:
        raise OSError(
            errno.ENOSPC,
            f"{len(plan.jobs)} scenes take about {plan.estimated_bytes / 1e9:.2f} GB, only "
            f"{plan.free_bytes / 1e9:.2f} GB are free; make room or choose another disk",
            str(plan.folder),
        )
    plan.folder.mkdir(parents=True, exist_ok=True)
    # Two runs would write into each other's unfinished scenes.
    refusal = f"another run is preparing scenes into {plan.folder}; wait for its end, or choose "
    with alone_in(plan.folder / LOCK, refusal + "another folder"):
        remove_leftovers(plan.folder)
        try:
            return _prepare(plan, workers, progress)
        finally:
            remove_leftovers(plan.folder)  # of workers that were killed


def _prepare(plan: PreparationPlan, workers: int, progress: bool) -> PreparationReport:
    report = PreparationReport(skipped=plan.skipped)
    total = len(plan.jobs) + plan.skipped
    try:
        refresh_index(plan.folder)
        with (
            progress_bar(total, unit="scene", done=plan.skipped, shown=progress) as bar,
            _outcomes(plan.jobs, plan.folder, workers) as outcomes,
        ):
            for name, outcome in outcomes:
                _count(report, name, outcome)
                if outcome.failure and progress:
                    bar.write(f"{name}: {outcome.failure}", file=sys.stderr)
                bar.set_postfix(frames=report.frames, failed=len(report.failed), refresh=False)
                bar.update()
    finally:
        refresh_index(plan.folder)
    return report


def _is_done(info: SceneInfo, folder: Path) -> bool:
    if not (folder / info.name / RECORD).exists():
        return False
    found, wanted = (
        asdict(read_scene(folder / info.name).info),
        json.loads(json.dumps(asdict(info))),
    )
    old, new = found["settings"], wanted["settings"]
    old[SPLIT_RULE] = new[SPLIT_RULE] = ""
    if found != wanted:
        pairs = {key: (found[key], wanted[key]) for key in wanted if key != "settings"}
        pairs |= {f"settings.{key}": (old.get(key), new.get(key)) for key in sorted(old | new)}
        differ = [f"{key} {was!r}, not {now!r}" for key, (was, now) in pairs.items() if was != now]
        raise ValueError(
            f"{folder} holds the scene {info.name} with {', '.join(differ)}; prepare into another "
            "folder, or delete the scene"
        )
    return True


def _count(report: PreparationReport, name: str, outcome: _Outcome) -> None:
    if outcome.failure is not None:
        report.failed[name] = outcome.failure
        return
    if outcome.left_out is not None:
        report.left_out[outcome.left_out] += 1
        return
    report.scenes += 1
    report.frames += outcome.frames
    report.num_bytes += outcome.num_bytes
    report.dropped.update(outcome.dropped)


@contextmanager
def _outcomes(
    jobs: Sequence[SceneJob], folder: Path, workers: int
) -> Iterator[Iterable[tuple[str, _Outcome]]]:
    """Names and outcomes as scenes end: in this process, or in fresh ones."""
    if workers == 1 or len(jobs) <= 1:
        yield ((job.info.name, _make(job, folder)) for job in jobs)
        return
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    pool = ProcessPoolExecutor(min(workers, len(jobs)), context, _begin_worker, (stop,))
    try:
        futures = {pool.submit(_make, job, folder): job.info.name for job in jobs}
        yield _finished(futures)
    finally:
        stop.set()  # whoever still works ends with its next frame and cleans up
        pool.shutdown(cancel_futures=True)


def _finished(futures: dict[Future[_Outcome], str]) -> Iterator[tuple[str, _Outcome]]:
    for future in as_completed(futures):
        try:
            yield futures[future], future.result()
        except BrokenProcessPool as error:
            raise MemoryError(
                "a process that prepared scenes was killed, probably for lack of memory; run it "
                "again with fewer workers"
            ) from error


class _StoppedError(Exception):
    """The main process wants no more."""


_stop: list[Event] = []


def _begin_worker(stop: Event) -> None:
    for name in ("SIGINT", "SIGHUP"):  # Ctrl-C and a closed terminal are for the main process alone
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    _stop.append(stop)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this process when the main one was killed; else it would wait for work for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _until_stopped(frames: Frames) -> Frames:
    for frame in frames:
        if _stop and _stop[0].is_set():
            raise _StoppedError
        yield frame


def _make(job: SceneJob, folder: Path) -> _Outcome:
    try:
        record = write_scene(folder, job.info, _until_stopped(job.frames()))
    except LeftOutError as reason:
        return _Outcome(left_out=str(reason))
    except UNREADABLE as error:
        if isinstance(error, OSError) and error.errno in FULL_DISK:
            raise
        known = isinstance(error, ValueError | KeyError | OSError)
        reason = error.args[0] if isinstance(error, KeyError) and error.args else error
        reason = " ".join(str(reason).split())
        return _Outcome(failure=reason if known else f"{type(error).__name__}: {reason}")
    return _Outcome(len(record.sources), record.num_bytes, record.dropped)
