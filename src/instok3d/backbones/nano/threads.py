"""How many threads the camera solver uses.

The solver runs tens of thousands of operations on small tensors. On several threads each of them is
a parallel region that ends with a barrier, where the threads spin until the last one arrives. When
another process holds one of the cores, that wait is far longer than the work: with all threads, the
geometry of eight photos has 24,000 such regions (docs/log.md). The solver runs on one thread, and
only steps with milliseconds of work use all of them.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import torch

_outside: ContextVar[int | None] = ContextVar("threads outside of one_thread", default=None)
_lock = threading.Lock()
_inside: list[int] = []
"""Number of threads outside of each `one_thread` of the process that is open now."""


@contextmanager
def one_thread() -> Iterator[None]:
    """PyTorch on one thread; also a decorator.

    The number of threads is restored at the end, also after an error.

    PyTorch keeps the number per Python thread, but a new Python thread starts with the number that
    was set last in the process. A Python thread that starts and enters while another one is inside
    would find 1 there; it takes and restores the number of the one that entered first. One that
    uses PyTorch for the first time during that and never enters keeps 1.
    """
    if _outside.get() is not None:
        yield
        return
    with _lock:
        outside = _inside[0] if _inside else torch.get_num_threads()
        _inside.append(outside)
        torch.set_num_threads(1)
    entered = _outside.set(outside)
    try:
        yield
    finally:
        _outside.reset(entered)
        with _lock:
            torch.set_num_threads(outside)
            _inside.remove(outside)


@contextmanager
def all_threads() -> Iterator[None]:
    """Inside of `one_thread`: as many threads as outside, for a step with work for all of them."""
    outside = _outside.get()
    inside = torch.get_num_threads()
    if outside is None or inside == outside:
        yield
        return
    torch.set_num_threads(outside)
    try:
        yield
    finally:
        torch.set_num_threads(inside)
