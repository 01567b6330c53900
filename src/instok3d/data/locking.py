"""Keeping a second run out of what one is writing."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def alone_in(lock: Path, refusal: str) -> Iterator[None]:
    """Hold a lock file, which is gone afterwards; one that a killed run left holds nobody up.

    Args:
        lock: The file. Its folder must be there.
        refusal: What another run hears: what is locked and what to do.

    Raises:
        ValueError: Another run holds it.
    """
    import fcntl  # not on Windows, where only what locks must fail

    with lock.open("w") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # A run that ended since the file was opened has removed it: no lock on that counts.
            held = os.path.samestat(os.fstat(stream.fileno()), lock.stat())
        except (BlockingIOError, FileNotFoundError):
            held = False
        if not held:
            raise ValueError(refusal)
        try:
            yield
        finally:
            lock.unlink()
