"""Renames that the standard library lacks: two names exchanged at once, a name taken if free."""

import ctypes
import errno
import os
from functools import cache
from pathlib import Path
from typing import Any

_NOT_KNOWN = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP)
"""Of kernels and file systems that lack such a rename."""
_HERE = -100  # AT_FDCWD: paths are as they are
_NO_REPLACE, _EXCHANGE = 1, 2


def exchange(first: Path, second: Path) -> bool:
    """Exchange what two paths name, both of which must be there, in one step.

    Returns:
        False where the system cannot: nothing was done then.
    """
    return _renamed(first, second, _EXCHANGE)


def rename_to_free(source: Path, target: Path) -> None:
    """Rename a file or folder unless something is at the target.

    Raises:
        FileExistsError: Something is.
    """
    taken = f"{target} has come to be there meanwhile, written by another run; it was kept"
    try:
        if _renamed(source, target, _NO_REPLACE):
            return
        if os.path.lexists(target):
            raise FileExistsError(taken)
        if source.is_dir() or not _linked(source, target):
            source.rename(target)  # fails where a folder has come to be there
    except OSError as error:
        if error.errno in (errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR):
            raise FileExistsError(taken) from error
        raise


def _linked(source: Path, target: Path) -> bool:
    """Give a file a second name if that is free; False where the file system has no such names."""
    try:
        os.link(source, target)
    except OSError as error:
        if error.errno in (*_NOT_KNOWN, errno.EPERM, errno.EMLINK):
            return False
        raise
    return True


def _renamed(source: Path, target: Path, flags: int) -> bool:
    rename = _renameat2()
    if rename is None:
        return False
    if rename(_HERE, os.fsencode(source), _HERE, os.fsencode(target), flags) == 0:
        return True
    number = ctypes.get_errno()
    if number in _NOT_KNOWN:
        return False
    raise OSError(number, os.strerror(number), str(target))


@cache
def _renameat2() -> Any:
    """The function of the C library; None outside Linux and in libraries before 2018."""
    try:
        return ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):  # the last on Windows
        return None
