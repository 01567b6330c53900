"""Everything that can only be seen on a GPU, in one command: is it right, how fast, how large?

    python benchmarks/gpu.py --out DIR

Needs a CUDA device, and nvcc where gsplat is not built yet; no network (`gather_wheels.sh` fetches
beforehand what is missing there). Each part runs in a process of its own with a time limit: an
error, a crash or a hang in one does not end the others. Results, measured times and memory, and the
lower bound that the hardware sets, are a table on stdout, printed last, and DIR/gpu.json. Exit code
1 where a part failed or a figure is out of its bounds, 2 where the command cannot be understood.

    python benchmarks/gpu.py --out DIR --only rasterizer forward-2view
    python benchmarks/gpu.py --out DIR --device cpu --toy     # the same code at toy sizes
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro
from gpu_parts import BUILD, PARTS
from gpu_parts.rows import Row, Setting

from instok3d.files import write_json
from instok3d.version import current_commit


@dataclass(frozen=True)
class Options:
    """What to run."""

    out: Path
    """Folder for gpu.json; made if it is not there."""
    device: str = "cuda"
    toy: bool = False
    """Small networks and pictures: shows that the code runs, measures nothing."""
    only: tuple[str, ...] = ()
    """These parts; none named = all."""
    minutes: float = 9.5
    """No part starts after this time, and none runs on beyond it."""
    minutes_per_part: float = 3.0
    """Of each part but the one that compiles gsplat, which may take all the time that is left."""
    in_this_process: str | None = None
    """Run one part here and write its rows to --out, a file: how the parts are started."""


@dataclass(frozen=True)
class Outcome:
    """What became of a part."""

    part: str
    seconds: float
    rows: tuple[Row, ...]
    error: str | None
    """How it ended and the last lines of its output; None where it ended well."""

    @property
    def good(self) -> bool:
        """Whether it ended well, with every figure within its bounds."""
        return self.error is None and all(row.good is not False for row in self.rows)


def main(options: Options) -> int:
    """Runs the parts one after another; the result is the exit code."""
    if options.in_this_process:
        rows = run_here(options.in_this_process, Setting(options.device, options.toy))
        write_json(options.out, [asdict(row) for row in rows])
        return 0
    if unknown := sorted(set(options.only) - set(PARTS)):
        print(f"no part {unknown}; there are {', '.join(PARTS)}", file=sys.stderr)
        return 2
    options.out.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + 60 * options.minutes
    outcomes = []
    for part in options.only or PARTS:
        print(f"{part} ...", file=sys.stderr, flush=True)
        outcomes.append(run_apart(options, part, end))
        # After every part, in case this process is ended.
        write_json(options.out / "gpu.json", as_json(options, outcomes))
    print(table(outcomes))
    return 0 if all(outcome.good for outcome in outcomes) else 1


def run_here(part: str, setting: Setting) -> list[Row]:
    """The rows of one part.

    Raises:
        ValueError: The device is a GPU and there is none.
    """
    if setting.on_gpu:
        from instok3d.training.distributed import check_device

        check_device(setting.device)
    return PARTS[part](setting)


def run_apart(options: Options, part: str, end: float) -> Outcome:
    """One part in a process of its own; never raises for what happens in there."""
    start = time.monotonic()
    left = end - start if part == BUILD else min(end - start, 60 * options.minutes_per_part)
    if left <= 0:
        return Outcome(part, 0.0, (), "not started: no time is left; raise --minutes")
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "rows.json"
        command = [sys.executable, __file__, "--in-this-process", part, "--out", str(result),
                   "--device", options.device, *(["--toy"] if options.toy else [])]  # fmt: skip
        error = _error_of(command, left)
        rows = json.loads(result.read_text()) if result.is_file() else []
    seconds = round(time.monotonic() - start, 1)
    return Outcome(part, seconds, tuple(Row(**row) for row in rows), error)


def _error_of(command: list[str], seconds: float) -> str | None:
    """How a command failed, if it did; at the time limit all that it started is ended."""
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
    ) as process:
        try:
            said = process.communicate(timeout=seconds)[0]
        except subprocess.TimeoutExpired as expired:
            return _with_end(f"stopped after {seconds:.0f} s", expired.output or b"")
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
    return _with_end(f"exit code {process.returncode}", said) if process.returncode else None


def _with_end(ending: str, said: bytes) -> str:
    """The last lines of an output, the most telling one last."""
    lines = said.decode(errors="replace").strip().splitlines()[-30:]
    return "\n".join([f"{ending}, after:", *lines]) if lines else ending


def as_json(options: Options, outcomes: list[Outcome]) -> dict:
    """What gpu.json holds."""
    return {
        "commit": current_commit(),
        "device": options.device,
        "toy": options.toy,
        "parts": [asdict(outcome) | {"good": outcome.good} for outcome in outcomes],
    }


def table(outcomes: list[Outcome]) -> str:
    """Markdown: a line for each figure, and one for each part that failed."""
    lines = ["| part | what | measured | expected | verdict |", "|---|---|---|---|---|"]
    for outcome in outcomes:
        rows = list(outcome.rows)
        if outcome.error:
            last = outcome.error.splitlines()[-1][:160]
            rows.append(Row(f"failed after {outcome.seconds:.0f} s", last, "no error", False))
        for row in rows:
            verdict = {True: "good", False: "BAD", None: ""}[row.good]
            cells = (outcome.part, row.what, row.measured, row.expected, verdict)
            lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |")
    failed = [outcome.part for outcome in outcomes if not outcome.good]
    lines += ["", f"{len(outcomes) - len(failed)} of {len(outcomes)} parts good"
              + (f"; look at {', '.join(failed)}" if failed else "")]  # fmt: skip
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options)))
