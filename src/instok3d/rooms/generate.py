"""Making a folder of rooms: many seeds, several processes, resumable shard by shard."""

import logging
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from instok3d.files import write_json
from instok3d.locking import alone_in, remove_leftovers
from instok3d.progress import progress_bar
from instok3d.rooms.catalogues.opened import (
    NO_CATALOGUES,
    Catalogues,
    told_apart,
    write_credits,
)
from instok3d.rooms.denoising import Denoiser, find_denoiser
from instok3d.rooms.levels import check_level
from instok3d.rooms.scene import render_scene
from instok3d.rooms.seeding import GENERATOR_VERSION, split_of
from instok3d.rooms.shards import (
    INDEX,
    SHARD_SEEDS,
    ShardRecord,
    add_to_index,
    new_index,
    read_index,
    shard_name,
    write_shard,
)
from instok3d.rooms.tracing import check_embree

log = logging.getLogger(__name__)

Result = TypeVar("Result")

LOCK = ".lock"
"""Held by the run that writes rooms to a folder."""


@dataclass(frozen=True)
class GenerationReport:
    """What a run of `generate_rooms` made."""

    scenes: int
    """New usable scenes."""
    rejected: int
    """New seeds without a camera path."""
    skipped: int
    """Seeds that were there already."""


_denoisers: list[Denoiser | None] = []


def _denoiser() -> Denoiser | None:
    """One denoiser a process."""
    if not _denoisers:
        _denoisers.append(find_denoiser())
    return _denoisers[0]


def _make_shard(
    shard: int, folder: Path, resolution: int, level: str, catalogues: Catalogues
) -> tuple[int, ShardRecord]:
    """Render and write all seeds of one shard."""
    seeds = range(shard * SHARD_SEEDS, (shard + 1) * SHARD_SEEDS)
    made = {seed: render_scene(seed, resolution, level, _denoiser(), catalogues) for seed in seeds}
    scenes = [scene for scene in made.values() if scene is not None]
    write_shard(folder / shard_name(shard), scenes)
    rejected = [seed for seed, scene in made.items() if scene is None]
    levels = [scene.meta["level"] for scene in scenes]
    return shard, ShardRecord([scene.meta["seed"] for scene in scenes], rejected, levels)


def _opened_index(folder: Path, resolution: int, level: str, catalogues: Catalogues) -> dict:
    """The folder's index, made if there is none; it must be of the same kind of rooms."""
    record = catalogues.record()
    if not (folder / INDEX).exists():
        write_json(folder / INDEX, new_index(resolution, level, record))
    index = read_index(folder)
    wanted = {"generator_version": GENERATOR_VERSION, "resolution": resolution, "level": level}
    for key, value in wanted.items():
        if index.get(key) != value:
            raise ValueError(
                f"{folder} holds rooms with {key} {index.get(key)!r}, not {value!r}; "
                "choose another folder"
            )
    there, asked = told_apart(index.get("catalogues", {})), told_apart(record)
    if there != asked:
        raise ValueError(
            f"{folder} holds rooms made with {_spelled(there)}, not with {_spelled(asked)}; "
            "choose another folder, or the same catalogues"
        )
    write_credits(folder, record)
    return index


def _spelled(catalogues: dict[str, str]) -> str:
    return " and ".join(f"{kind} {name}" for kind, name in catalogues.items()) or "no catalogue"


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Child processes that start inside use one thread: the rooms are spread, not their loops."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def generate_rooms(
    folder: Path,
    seeds: range,
    *,
    resolution: int = 128,
    level: str = "mix",
    workers: int = 2,
    catalogues: Catalogues = NO_CATALOGUES,
    progress: bool = True,
) -> GenerationReport:
    """Render the rooms of some seeds into a folder of shards; finished shards are kept.

    Whole shards are made: every multiple of 16 that the range touches. A folder can be stopped
    at any time, grown later, and read while it grows; one process at a time may write to it.

    Args:
        folder: Made if it is not there.
        seeds: Training seeds are 0 to 999,999; see `SPLIT_STARTS` for the other splits.
        resolution: Height and width of the pictures, pixels.
        level: mix (30 % easy, 50 % medium, 20 % hard, by seed), easy, medium, hard or real.
        workers: Processes.
        catalogues: Furniture models and texture files to make some of the rooms' content of.
        progress: A bar on stderr, where that is a terminal.

    Raises:
        ModuleNotFoundError: The ray tracer is not installed.
        NotADirectoryError: The folder is a file.
        ValueError: Bad seeds, level, resolution or workers, the folder holds rooms of another
            kind, or another run is writing to it.
    """
    _check(seeds, resolution, level, workers)
    check_embree()
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"cannot write rooms to {folder}: it is a file, not a folder")
    folder.mkdir(parents=True, exist_ok=True)
    refusal = (
        f"another run is writing rooms to {folder}; wait for its end, or choose another folder"
    )
    with alone_in(folder / LOCK, refusal):
        remove_leftovers(folder)
        try:
            return _generate(folder, seeds, resolution, level, workers, catalogues, progress)
        finally:
            remove_leftovers(folder)  # of workers that were ended while they wrote


def _generate(
    folder: Path,
    seeds: range,
    resolution: int,
    level: str,
    workers: int,
    catalogues: Catalogues,
    progress: bool,
) -> GenerationReport:
    shards = range(seeds[0] // SHARD_SEEDS, seeds[-1] // SHARD_SEEDS + 1)
    done = _opened_index(folder, resolution, level, catalogues)["shards"]
    names = {s: shard_name(s) for s in shards}
    missing = [s for s, name in names.items() if not (name in done and (folder / name).is_file())]
    make = partial(
        _make_shard, folder=folder, resolution=resolution, level=level, catalogues=catalogues
    )
    scenes = rejected = 0
    skipped = (len(shards) - len(missing)) * SHARD_SEEDS
    total = len(shards) * SHARD_SEEDS
    with (
        progress_bar(total, unit="room", done=skipped, shown=progress) as bar,
        _results(make, missing, workers) as results,
    ):
        for shard, record in results:
            add_to_index(folder, shard, record)
            scenes += len(record.seeds)
            rejected += len(record.rejected)
            bar.set_postfix(rejected=rejected, refresh=False)
            bar.update(SHARD_SEEDS)
    if rejected:
        log.warning("%d of %d seeds gave no camera path", rejected, scenes + rejected)
    return GenerationReport(scenes, rejected, skipped)


def _check(seeds: range, resolution: int, level: str, workers: int) -> None:
    """Raise ValueError for what cannot be made."""
    if not len(seeds) or seeds.step != 1:
        raise ValueError(f"seeds {seeds} is no range of seeds; give first:last+1, such as 0:2000")
    if not 16 <= resolution <= 2048:
        raise ValueError(f"resolution {resolution} is outside 16 to 2048 pixels")
    check_level(level)
    if workers < 1:
        raise ValueError(f"workers must be 1 or more, got {workers}")
    for seed in (seeds[0], seeds[-1]):
        split_of(seed)


def _leave_signals_to_main_process() -> None:
    """Ctrl-C and a closed terminal reach all; the main process then ends the others by SIGTERM."""
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)


@contextmanager
def _results(
    make: Callable[[int], Result], shards: list[int], workers: int
) -> Iterator[Iterable[Result]]:
    """Finished shards as they come: in this process, or from a pool of fresh ones."""
    if workers <= 1 or len(shards) <= 1:
        yield map(make, shards)
        return
    with _one_thread_each():
        pool = multiprocessing.get_context("spawn").Pool(
            min(workers, len(shards)), _leave_signals_to_main_process
        )
    with pool:
        yield pool.imap_unordered(make, shards)
