"""A training run that is killed without warning once it has saved, as a cut of power would.

    python runs/killed_once.py RUN -- torchrun --nproc-per-node 2 -m instok3d train ... -o RUN

SIGKILL goes to the command and to every process that it has started; exit code 0 says that it was
killed, 1 that it ended before.
"""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path


def descendants(process: int) -> list[int]:
    """The processes that a process has started, and theirs (Linux)."""
    parents: dict[int, list[int]] = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            after_name = entry.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue  # it has just ended
        parents.setdefault(int(after_name[1]), []).append(int(entry.parent.name))
    found = parents.get(process, [])
    return found + [below for each in found for below in descendants(each)]


def main() -> int:
    """Run the command after `--` until a checkpoint is there, and kill it."""
    run, separator, *command = sys.argv[1:]
    if separator != "--" or not command:
        raise SystemExit("usage: killed_once.py RUN -- COMMAND ...")
    started = subprocess.Popen(command)
    while started.poll() is None:
        if any(Path(run, "checkpoints").glob("step_*")):
            below = descendants(started.pid)
            for process in (started.pid, *below):
                os.kill(process, signal.SIGKILL)
            started.wait()
            print(f"killed {1 + len(below)} processes", file=sys.stderr)
            return 0
        time.sleep(0.05)
    print(f"the run ended with exit code {started.returncode} before it was killed",
          file=sys.stderr)  # fmt: skip
    return 1


if __name__ == "__main__":
    sys.exit(main())
