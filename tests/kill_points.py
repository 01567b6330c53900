"""What a process leaves that is killed at its n-th file operation, for every n in turn."""

import os
import shutil
import signal
import sys
import tempfile
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
    """The folder as each of the kills would leave it, and at last as the whole run leaves it.

    The function runs once, and the folder is copied before each operation: what a killed process
    has not given to the system yet is in no copy, and its locks hold none. Copies like the one
    before are left out. test_kill_points.py compares them with real kills.

    Args:
        prepare: Makes the folder.
        function: Writes below the folder. It must not use several threads: it runs in a fork.
        step: Only every so many operations.
    """
    folder = prepare()
    with tempfile.TemporaryDirectory() as place:
        copies = Path(place)
        code = _exit_code(lambda: _copied(folder, function, step, copies), function)
        assert code == 0, f"{function} failed"
        found = sorted(copies.iterdir(), key=lambda copy: int(copy.name))
        assert len(found) > 3, "hardly anything was copied: are the operations counted?"
        for copy in found:
            shutil.rmtree(folder)
            shutil.move(copy, folder)
            yield folder


def _copied(folder: Path, function: Callable[[Path], Any], step: int, copies: Path) -> None:
    """Run the function; a copy of the folder for each state, named by the operation before it."""
    last: dict[str, bytes | None] = {}

    def copy(number: int) -> None:
        nonlocal last
        if number % step == 1 % step:
            now = contents(folder)
            if number == 1 or now != last:
                shutil.copytree(folder, copies / str(number))
            last = now

    number = _at_each_operation(folder, copy)
    function(folder)
    copy(step * (number() + 1) + 1)


def contents(folder: Path) -> dict[str, bytes | None]:
    """The bytes of each file below a folder, and None for each folder."""
    return {
        str(path.relative_to(folder)): None if path.is_dir() else path.read_bytes()
        for path in sorted(folder.rglob("*"))
    }


def killed_at(number: int, folder: Path, function: Callable[[Path], Any]) -> bool:
    """Whether a process that dies at an operation of that number, from 1, got so far."""

    def strike(count: int) -> None:
        if count == number:
            os.kill(os.getpid(), signal.SIGKILL)

    def run() -> None:
        _at_each_operation(folder, strike)
        function(folder)

    code = _exit_code(run, function)
    assert code in (0, -signal.SIGKILL), f"{function} failed"
    return code != 0


def _exit_code(run: Callable[[], None], what: object) -> int:
    """Of a fork that runs something."""
    sys.stdout.flush()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forks where there are threads
        child = os.fork()
    if child == 0:
        try:
            run()
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
        raise TimeoutError(f"{what} hangs")
    return os.waitstatus_to_exitcode(found[1])


def _at_each_operation(folder: Path, act: Callable[[int], None]) -> Callable[[], int]:
    """Act before each operation from now on, given its number; how many there were is answered."""
    done, acting = 0, False

    def count() -> None:
        nonlocal done, acting
        if not acting:
            done, acting = done + 1, True
            act(done)
            acting = False

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
    return lambda: done


def die_in(target: Path) -> None:
    """Leave beside a file or folder what a process leaves that is killed while it writes it."""

    def write(folder: Path) -> None:
        with workplace(target) as place:
            (place / "half").write_text("half")
            os.kill(os.getpid(), signal.SIGKILL)

    assert killed_at(10**9, target.parent, write)
