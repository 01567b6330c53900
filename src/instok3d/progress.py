"""How far a long command is and how long it has taken: on a terminal alone, and on stderr alone."""

import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm

REDRAWN_S = 1.0
THREAD = "redraw progress"
CLEAR = "\r\033[K"
"""Takes back what stands on a terminal's last line."""


@contextmanager
def progress_bar(total: int, *, unit: str, done: int = 0, shown: bool = True) -> Iterator[tqdm]:
    """A bar with rate and time left; its clock goes on while nothing is finished.

    Args:
        total: How many there are.
        unit: Of what, such as scene.
        done: How many were there before.
        shown: Whether at all.
    """
    hidden = None if shown else True  # None: where there is no terminal
    with (
        tqdm(total=total, initial=done, unit=unit, file=sys.stderr, disable=hidden) as bar,
        _repeated(bar.refresh if not bar.disable else None),
    ):
        yield bar


class StatusLine:
    """A terminal's last line: what is being done, and for how long; other lines go above it."""

    def __init__(self) -> None:
        self.on_terminal = sys.stderr.isatty()
        self._lock = threading.Lock()
        self._text, self._since = "", 0.0

    @contextmanager
    def running(self) -> Iterator[None]:
        """While inside, the line is redrawn every second; behind it, it is gone."""
        with _repeated(self._redraw if self.on_terminal else None):
            try:
                yield
            finally:
                self.show("")

    def show(self, text: str) -> None:
        """Show this from now on; the time counts from here. An empty text shows nothing."""
        self._text, self._since = text, time.monotonic()
        if self.on_terminal:
            self._redraw()

    def print_above(self, text: str) -> None:
        """Print a line that stays, also where there is no terminal."""
        with self._lock:
            print(f"{CLEAR if self.on_terminal else ''}{text}", file=sys.stderr, flush=True)
        if self.on_terminal:
            self._redraw()

    def _redraw(self) -> None:
        with self._lock:
            text = self._text
            if text and (waited_s := time.monotonic() - self._since) >= REDRAWN_S:
                text = f"{text}  {format_duration(waited_s)}"
            # A line that wraps could not be taken back.
            text = text[: shutil.get_terminal_size().columns - 1]
            print(CLEAR + text, end="", file=sys.stderr, flush=True)


def format_duration(seconds: float) -> str:
    """Hours and minutes, or minutes and seconds below an hour."""
    minutes, rest = divmod(int(seconds), 60)
    return f"{minutes // 60}h{minutes % 60:02d}m" if minutes >= 60 else f"{minutes}m{rest:02d}s"


@contextmanager
def _repeated(action: Callable[[], object] | None) -> Iterator[None]:
    """Call the action every REDRAWN_S in a thread of its own while inside; None does nothing."""
    if action is None:
        yield
        return
    stop = threading.Event()

    def repeat() -> None:
        while not stop.wait(REDRAWN_S):
            action()

    thread = threading.Thread(target=repeat, name=THREAD, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
