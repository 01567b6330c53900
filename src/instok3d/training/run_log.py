"""The record of a run: metrics.jsonl, one line on the console, curves."""

import json
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from instok3d.files import replacing
from instok3d.progress import StatusLine, format_duration
from instok3d.reading import naming_damage, text, whole_number


class RunLog:
    """Appends to RUN/metrics.jsonl and prints; a resumed run drops lines after its checkpoint.

    Each line of the file is an object with kind ("train" or "validation"), step, elapsed_s and
    the figures. No kind has two lines of one step.

    Args:
        folder: The run; None for a process that is to be silent.
        total_steps: Updates of the whole run.
        first_step: Updates done.
        resumed: Whether the lines up to first_step are of this run; else the file begins anew.
    """

    def __init__(
        self,
        folder: Path | None,
        *,
        total_steps: int,
        first_step: int = 0,
        resumed: bool = False,
    ) -> None:
        self._path = None if folder is None else folder / "metrics.jsonl"
        self._total_steps = total_steps
        self._written: set[tuple[str, int]] = set()
        if self._path is not None:
            self._keep_until(self._path, first_step if resumed else -1)
        self._last_step, self._last_time = first_step, time.monotonic()
        self._step_s: float | None = None
        self._status = StatusLine()

    @contextmanager
    def showing(self) -> Iterator[None]:
        """While inside, a terminal's last line says what the run is doing."""
        with self._status.running():
            yield

    def working(self, what: str) -> None:
        """Show what the run is doing from now on."""
        if self._path is not None:
            self._status.show(what)

    def stepping(self, step: int) -> None:
        """Show the step that has begun, and the time to the end once one step is done.

        Args:
            step: Updates done before it.
        """
        if step > self._last_step:
            self._step_s = (time.monotonic() - self._last_time) / (step - self._last_step)
        left = ""
        if self._step_s is not None:
            left = f"  {self._speed(self._step_s, step)}"
        self.working(f"step {step + 1}/{self._total_steps}{left}")

    def train(self, step: int, elapsed_s: float, figures: dict[str, float]) -> None:
        """Write a line of training figures and print it with speed and time to the end.

        The time leaves validation and saving out.
        """
        now = time.monotonic()
        step_s = (now - self._last_time) / max(1, step - self._last_step)
        self._last_step, self._last_time, self._step_s = step, now, step_s
        self._write("train", step, elapsed_s, {**figures, "step_s": step_s})
        self.say(
            f"step {step}/{self._total_steps}  {format_figures(figures)}  "
            f"{self._speed(step_s, step)}"
        )

    def validation(self, step: int, elapsed_s: float, figures: dict[str, float]) -> None:
        """Write and print validation figures."""
        self._write("validation", step, elapsed_s, figures)
        self.say(f"step {step}/{self._total_steps}  validation  {format_figures(figures)}")

    def say(self, text: str) -> None:
        """One line on the console."""
        if self._path is not None:
            self._status.print_above(text)

    def pause(self, seconds: float) -> None:
        """Leave time that was not spent on steps (validation, saving) out of the speed."""
        self._last_time += seconds

    def _speed(self, step_s: float, step: int) -> str:
        left = format_duration(step_s * (self._total_steps - step))
        return f"{step_s:.2f} s/step  {left} left"

    def _write(self, kind: str, step: int, elapsed_s: float, figures: dict[str, float]) -> None:
        if self._path is None or (kind, step) in self._written:
            return
        self._written.add((kind, step))
        line = {"kind": kind, "step": step, "elapsed_s": round(elapsed_s, 1)}
        # JSON has no NaN, which is what a figure is that nothing was there to measure.
        finite = {name: value for name, value in figures.items() if math.isfinite(value)}
        line |= {name: float(f"{value:.6g}") for name, value in finite.items()}
        with self._path.open("a") as stream:
            stream.write(json.dumps(line) + "\n")

    def _keep_until(self, path: Path, step: int) -> None:
        kept = [line for line in read_metrics(path) if line["step"] <= step]
        self._written = {(line["kind"], line["step"]) for line in kept}
        with replacing(path) as part:
            part.write_text("".join(json.dumps(line) + "\n" for line in kept))


class RunningMeans:
    """Means of each figure since they were last taken."""

    def __init__(self) -> None:
        self._sums: dict[str, tuple[float, int]] = {}

    def add(self, figures: dict[str, float]) -> None:
        """Count one more value of each figure."""
        for name, value in figures.items():
            total, count = self._sums.get(name, (0.0, 0))
            self._sums[name] = (total + value, count + 1)

    def take(self) -> dict[str, float]:
        """The means, and begin again."""
        means = {name: total / count for name, (total, count) in self._sums.items()}
        self._sums = {}
        return means


def read_metrics(path: Path) -> list[dict]:
    """The lines of a metrics.jsonl; a last line that was cut short is left out.

    Raises:
        ValueError: Another line is damaged.
    """
    if not path.exists():
        return []
    remedy = "remove that line"
    lines = path.read_bytes().splitlines()
    result = []
    for place, line in enumerate(lines, start=1):
        try:
            with naming_damage(f"{path}, line {place},", remedy):
                record = json.loads(line)  # figures of a run that failed may be NaN
                text(record["kind"])
                whole_number(record["step"])
        except ValueError:
            if place < len(lines):
                raise
            break
        result.append(record)
    return result


def format_figures(figures: dict[str, float]) -> str:
    """Names and four digits of each figure, on one line."""
    return "  ".join(f"{name} {value:.4g}" for name, value in figures.items())
