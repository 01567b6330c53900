"""Times the geometry of the demo's photos on a free machine and beside a busy neighbour.

Three settings take turns in one process, without and with another process that computes all the
time: one thread; all threads everywhere, as it was before `one_thread`; all threads, but the camera
solver on one. The last two are also timed with threads that wait passively (OMP_WAIT_POLICY). Times
are medians, divided by that of one thread on the free machine.

    python benchmarks/busy.py

Nothing else may run, and there must be as many free cores as threads. It takes minutes: beside a
neighbour a single run on all threads takes from 8 s to over two minutes.
"""

import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path

import torch
import tyro

from instok3d.backbones.nano import threads
from instok3d.model.files import load_model
from instok3d.photos.loading import read_photos


@dataclass(frozen=True)
class Options:
    """What to time."""

    threads: int = 2
    neighbours: int = 1
    """Other processes that compute all the time."""
    repeats: int = 3
    """Timed runs of each setting, after one that does not count."""
    measure: bool = False
    """Only print the seconds of the three settings in this process, as JSON; for the rows."""


ONE, ALL, APART = "one thread", "all on {0} threads", "{0} threads, the camera solver on one"


@contextmanager
def solver_on_all_threads(count: int) -> Iterator[None]:
    """As before `one_thread`: it does nothing where this thread is taken to be inside already."""
    entered = threads._outside.set(count)
    try:
        yield
    finally:
        threads._outside.reset(entered)


def measure(options: Options) -> dict[str, float]:
    """Median seconds of each setting; the settings take turns."""
    folder = Path(str(files("instok3d") / "assets" / "demo"))
    views = read_photos(folder, height=128, width=128, max_views=8).views
    backbone = load_model().backbone.eval()
    times_s: dict[str, list[float]] = {ONE: [], ALL: [], APART: []}
    for repeat in range(options.repeats + 1):
        for kind, found in times_s.items():
            count = 1 if kind == ONE else options.threads
            torch.set_num_threads(count)
            start = time.perf_counter()
            with torch.no_grad():
                if kind == ALL:
                    with solver_on_all_threads(count):
                        backbone(views)
                else:
                    backbone(views)
            if repeat:
                found.append(time.perf_counter() - start)
    return {kind: statistics.median(found) for kind, found in times_s.items()}


def in_a_process(options: Options, **environment: str) -> dict[str, float]:
    """`measure` in its own process, because OpenMP reads its environment when it is loaded."""
    words = [f"--{name}={value}" for name, value in asdict(options).items() if name != "measure"]
    command = [sys.executable, __file__, "--measure", *words]
    own = {name: value for name, value in os.environ.items() if name != "OMP_WAIT_POLICY"}
    shown = subprocess.run(
        command, env=own | environment, stdout=subprocess.PIPE, check=True, text=True
    )
    return json.loads(shown.stdout)


def main(options: Options) -> None:
    """Prints a Markdown table."""
    if options.measure:
        print(json.dumps(measure(options)))
        return
    found = []
    for neighbours in (0, options.neighbours):
        busy = [
            subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(neighbours)
        ]
        try:
            active = in_a_process(options)
            passive = in_a_process(options, OMP_WAIT_POLICY="passive")
        finally:
            for process in busy:
                process.kill()
                process.wait()
        del passive[ONE]
        found.append(active | {f"{kind}, waiting passively": s for kind, s in passive.items()})
    free, busy = found
    print(f"| geometry of 8 photos | free | {options.neighbours} busy neighbour |\n|---|---|---|")
    for kind, seconds in free.items():
        row = f"{seconds / free[ONE]:.2f} | {busy[kind] / free[ONE]:.2f}"
        print(f"| {kind.format(options.threads)} | {row} |")
    print(f"\n1.00 is {free[ONE]:.2f} s")


if __name__ == "__main__":
    main(tyro.cli(Options))
