"""What a long command says while it works: stages, their times, warnings; all on stderr."""

import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from instok3d.progress import CLEAR, StatusLine


class StageClock:
    """Shows the stage that has begun and keeps how long each one took."""

    def __init__(self) -> None:
        self.times_s: dict[str, float] = {}
        self._line = StatusLine()
        self._stage: str | None = None
        self._since = time.perf_counter()

    @contextmanager
    def running(self) -> Iterator[None]:
        """While inside, a terminal shows how long a stage has been going on."""
        with self._line.running():
            yield
        self.end()

    def begin(self, text: str) -> None:
        """Begin a stage, which ends the one before; or show how far the same one is.

        Args:
            text: Its name; behind a colon, how far it is, which a terminal alone shows.
        """
        stage = text.split(":", 1)[0]
        if stage != self._stage:
            self.end()
            self._stage = stage
            if not self._line.on_terminal:
                print(f"{stage} ...", file=sys.stderr, flush=True)
        self._line.show(f"{text} ...")

    def end(self) -> None:
        """End the stage that runs, if one does."""
        now = time.perf_counter()
        if self._stage is not None:
            self.times_s[self._stage] = self.times_s.get(self._stage, 0.0) + now - self._since
        self._stage, self._since = None, now

    @property
    def total_s(self) -> float:
        """Of all stages that have ended."""
        return sum(self.times_s.values())

    def report(self) -> str:
        """A table: stage, seconds, share of the whole."""
        total = self.total_s
        rows = [*self.times_s.items(), ("all", total)]
        return "\n".join(
            f"{stage:10} {seconds:7.2f} s {100 * seconds / max(total, 1e-9):4.0f} %"
            for stage, seconds in rows
        )


@contextmanager
def plain_warnings() -> Iterator[None]:
    """Python warnings become one line each on stderr, without the place in the code."""

    def show(message: Warning | str, *rest: object) -> None:
        clear = CLEAR if sys.stderr.isatty() else ""
        print(f"{clear}instok3d: note: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("default")
        warnings.showwarning = show
        yield
