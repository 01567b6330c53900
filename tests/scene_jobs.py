"""Jobs of preparation whose frames do what a test needs.

A module of its own, so that the processes of a preparation can import them.
"""

import os
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from instok3d.datasets.preparation import SceneJob, plan_preparation, prepare
from instok3d.datasets.prepared import DroppedFrame, PreparedFrame, SceneInfo
from prepared_scenes import made_frame


def some_frames(
    count: int, fault: Exception | None = None
) -> Iterator[PreparedFrame | DroppedFrame]:
    yield made_frame(0)
    yield DroppedFrame("x", "no pose")
    if fault is not None:
        raise fault
    for number in range(1, count):
        yield made_frame(number)


def killing_frames(signal_number: int) -> Iterator[PreparedFrame]:
    yield made_frame(0)
    os.kill(os.getpid(), signal_number)
    time.sleep(60)


def slow_frames(started: Path) -> Iterator[PreparedFrame]:
    started.touch()
    for number in range(10_000):
        time.sleep(0.01)
        yield made_frame(number)


def frames_during_another_run(folder: Path) -> Iterator[PreparedFrame]:
    run([job("z")], folder)
    yield made_frame(0)


def job(name: str, frames: Callable = some_frames, *arguments, **settings) -> SceneJob:
    info = SceneInfo(name, "scannet", "train", "metre", settings)
    return SceneJob(info, 1000, partial(frames, *(arguments or (3,))))


def run(jobs: list[SceneJob], folder: Path, workers: int = 1):
    return prepare(plan_preparation(jobs, folder), workers=workers, progress=False)
