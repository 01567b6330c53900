"""The most memory that a piece of work holds at a time."""

import ctypes
import gc
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import torch

CLEAR_REFS = Path("/proc/self/clear_refs")
STATUS = Path("/proc/self/status")
RESET_PEAK = "5"
"""Written to CLEAR_REFS: the peak becomes what is resident now (Linux, proc(5))."""


@dataclass
class Peak:
    """Known when the block has ended."""

    bytes: int | None = None
    """None where the system does not say."""


@contextmanager
def peak_memory(device: torch.device) -> Iterator[Peak]:
    """The peak of a block that works on a device.

    On the CPU the largest resident size of the process in the block: the program, the weights and
    the data that are there in any case are in it, what earlier work has freed is first given back
    to the system. On Linux alone, which can begin its count anew; `getrusage` cannot, so that it
    would give a small scene the peak of a large one before it. On CUDA the most that torch had
    allocated on the device, without the driver's own.
    """
    peak = Peak()
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats(device)
        yield peak
        peak.bytes = torch.cuda.max_memory_allocated(device)
        return
    counts = _counts_anew()
    yield peak
    if counts:
        peak.bytes = _resident_peak()


def _counts_anew() -> bool:
    gc.collect()
    with suppress(OSError, AttributeError):  # of glibc alone
        ctypes.CDLL(None).malloc_trim(0)
    try:
        CLEAR_REFS.write_text(RESET_PEAK)
    except OSError:
        return False
    return True


def _resident_peak() -> int | None:
    for line in STATUS.read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    return None
