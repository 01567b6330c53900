"""Work for processes some of which die; they import it by its name."""

import os
import signal
import time
from pathlib import Path

from patience import SECONDS


def work(job: tuple[int, Path]) -> tuple[int, int]:
    """Number and process; 3 fails, 4 dies once, 5 dies always, after 4 died.

    Otherwise 5 could end the pool before 4 has begun, whose only death would come when it is alone.
    """
    number, folder = job
    if number == 3:
        raise ValueError("three is refused")
    end = time.monotonic() + SECONDS
    while number == 5 and not (folder / "4 began").exists():
        assert time.monotonic() < end, "4 never began"
        time.sleep(0.01)
    mark = folder / f"{number} began"
    if number == 5 or (number == 4 and not mark.exists()):
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number, os.getpid()
