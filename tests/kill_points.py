"""Functions run in processes that are killed at their n-th file operation, for every n in turn."""

import os
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import patience
from instok3d.locking import workplace

OPERATIONS = (
    "open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.chmod", "os.truncate"
)  # fmt: skip
"""Audited before they are done; os.fsync is counted too."""


def every_kill(
    prepare: Callable[[], Path], function: Callable[[Path], Any], step: int = 1
) -> Iterator[Path]:
    """The folder as it was left by each of the kills, and at last as the whole run leaves it.

    Args:
        prepare: Makes the folder anew.
        function: Writes below the folder. It must not use several threads: it runs in a fork.
        step: Only every so many operations.
    """
    number = 1
    while _killed_at(number, folder := prepare(), function):
        yield folder
        number += step
    assert number > 3 * step, "hardly anything was killed: are the operations counted?"
    yield folder


def _killed_at(number: int, folder: Path, function: Callable[[Path], Any]) -> bool:
    """Whether a process that dies at an operation of that number, from 1, got so far."""
    sys.stdout.flush()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forks where there are threads
        child = os.fork()
    if child == 0:
        try:
            _strike(number, folder)
            function(folder)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    ends = time.monotonic() + patience.SECONDS
    while (found := os.waitpid(child, os.WNOHANG))[0] == 0 and time.monotonic() < ends:
        time.sleep(0.001)
    if found[0] == 0:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        raise TimeoutError(f"{function} hangs at operation {number}")
    code = os.waitstatus_to_exitcode(found[1])
    assert code in (0, -signal.SIGKILL), f"{function} failed"
    return code != 0


def _strike(number: int, folder: Path) -> None:
    left = [number]

    def count() -> None:
        left[0] -= 1
        if left[0] == 0:
            os.kill(os.getpid(), signal.SIGKILL)

    def watch(event: str, arguments: tuple) -> None:
        # Of what lies in a folder that is removed, only the names are given.
        place = str(arguments[0]) if event in OPERATIONS else "/"
        if not os.path.isabs(place) or place.startswith(str(folder)):
            count()

    def fsync(handle: int) -> None:
        count()
        sync(handle)

    sys.addaudithook(watch)
    sync, os.fsync = os.fsync, fsync


def die_in(target: Path) -> None:
    """Leave beside a file or folder what a process leaves that is killed while it writes it."""

    def write(folder: Path) -> None:
        with workplace(target) as place:
            (place / "half").write_text("half")
            os.kill(os.getpid(), signal.SIGKILL)

    assert _killed_at(10**9, target.parent, write)
