"""What a long command says while it works: stages, their times, warnings; all on stderr."""

import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager


class StageClock:
    """Shows the stage that has begun and keeps how long each one took."""

    def __init__(self) -> None:
        self.times_s: dict[str, float] = {}
        self._stage: str | None = None
        self._since = time.perf_counter()

    def begin(self, stage: str) -> None:
        """End the stage before and begin this one."""
        self.end()
        self._stage = stage
        if sys.stderr.isatty():
            print(f"\r\033[K{stage} ...", end="", file=sys.stderr, flush=True)
        else:
            print(f"{stage} ...", file=sys.stderr, flush=True)

    def end(self) -> None:
        """End the stage that runs, if one does."""
        now = time.perf_counter()
        if self._stage is not None:
            self.times_s[self._stage] = self.times_s.get(self._stage, 0.0) + now - self._since
            if sys.stderr.isatty():
                print("\r\033[K", end="", file=sys.stderr, flush=True)
        self._stage, self._since = None, now

    def report(self) -> str:
        """A table: stage, seconds, share of the whole."""
        total = sum(self.times_s.values())
        rows = [*self.times_s.items(), ("all", total)]
        return "\n".join(
            f"{stage:10} {seconds:7.2f} s {100 * seconds / max(total, 1e-9):4.0f} %"
            for stage, seconds in rows
        )


@contextmanager
def plain_warnings() -> Iterator[None]:
    """Python warnings become one line each on stderr, without the place in the code."""

    def show(message: Warning | str, *rest: object) -> None:
        print(f"instok3d: note: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("default")
        warnings.showwarning = show
        yield
