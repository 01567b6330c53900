"""Scenes of a batch some of whose processes die; they import it by its name."""

import os
import signal
import sys
from pathlib import Path

from instok3d.batch.scenes import MadeScene, SceneJob, held_model, make_scene


def dying_scene(job: SceneJob) -> tuple[MadeScene, float]:
    """A scene as batches make it; bath dies once while it is written, cursed always.

    Instead of seconds it gives how often this process has read a model.
    """
    folder = job.output.parent.parent / "marks"
    folder.mkdir(exist_ok=True)
    mark = folder / f"{job.name} began"
    if job.name == "cursed" or (job.name == "bath" and not mark.exists()):
        _die_when_written(job.output.parent, mark)
    made = make_scene(job)
    return made, float(held_model.cache_info().misses)


def _die_when_written(folder: Path, mark: Path) -> None:
    """Die when half of a scene lies in a folder, under its hidden name."""

    def watch(event: str, arguments: tuple) -> None:
        if event == "open" and str(arguments[0]).endswith("scene.json") and arguments[1] != "r":
            mark.write_text(" ".join(path.name for path in folder.glob(".instok3d-*")))
            os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(watch)
