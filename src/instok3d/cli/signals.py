"""Ctrl-C, SIGTERM and SIGHUP as an orderly end: what was begun is cleared away."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

NAMES = ("SIGINT", "SIGTERM", "SIGHUP")


class EndedBySignal(KeyboardInterrupt):
    """The process was asked to end.

    A class of its own: where KeyboardInterrupt itself has passed through an exec, as in the import
    of a dataclass, CPython ends by the signal and not with the exit code (run_eval_code_obj).
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@contextmanager
def orderly_end() -> Iterator[None]:
    """Let SIGINT, SIGTERM and SIGHUP raise `EndedBySignal` in the block; only the first one does.

    After it SIGTERM and SIGHUP are ignored, so that clearing away is not cut short, and a second
    Ctrl-C is that of Python.

    A signal that was ignored before, as SIGHUP under nohup, stays ignored. In other threads than
    the main one, which alone receives signals, nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    owner = os.getpid()

    def end(number: int, _frame: object) -> None:
        for each in before:
            again = signal.default_int_handler if each == signal.SIGINT else signal.SIG_IGN
            signal.signal(each, again if os.getpid() == owner else signal.SIG_DFL)
        if os.getpid() != owner:  # a fork, in which the owner's files are not to be cleared away
            os.kill(os.getpid(), number)
        raise EndedBySignal(number)

    numbers = [getattr(signal, name) for name in NAMES if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in numbers}
    before = {number: handler for number, handler in before.items() if handler != signal.SIG_IGN}
    for number in before:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def asked_to_stop(*, when: bool) -> Iterator[Callable[[], bool] | None]:
    """Let the first Ctrl-C in the block be a request, which the given function tells of.

    The second one, and other signals, end the process as without the block.

    Args:
        when: Off changes nothing and gives None.
    """
    if not when or threading.current_thread() is not threading.main_thread():
        yield None
        return
    before = signal.getsignal(signal.SIGINT)
    asked = threading.Event()

    def note(_number: int, _frame: object) -> None:
        asked.set()
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, note)
    try:
        yield asked.is_set
    finally:
        signal.signal(signal.SIGINT, before)
