"""Keeping a second run out of what one is writing."""

import errno
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

_WITHOUT_LOCKS = (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK)
"""Of file systems without locks, such as Lustre in its default form."""


@contextmanager
def alone_in(lock: Path, refusal: str) -> Iterator[None]:
    """Hold a lock file, which is gone afterwards; one that a killed run left holds nobody up.

    Where the file system has no locks, a warning says so and nobody is kept out.

    Args:
        lock: The file. Its folder must be there.
        refusal: What another run hears: what is locked and what to do.

    Raises:
        ValueError: Another run holds it.
    """
    with lock.open("w") as stream:
        if not _is_held(stream, lock):
            raise ValueError(refusal)
        try:
            yield
        finally:
            lock.unlink(missing_ok=True)


def _is_held(stream: IO[str], lock: Path) -> bool:
    import fcntl  # not on Windows, where only what locks must fail

    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # A run that ended since the file was opened has removed it: no lock on that counts.
        return os.path.samestat(os.fstat(stream.fileno()), lock.stat())
    except (BlockingIOError, FileNotFoundError):
        return False
    except OSError as error:
        if error.errno not in _WITHOUT_LOCKS:
            raise
        warnings.warn(
            f"the disk of {lock.parent} has no locks; see to it that no other run writes there",
            stacklevel=4,
        )
        return True
