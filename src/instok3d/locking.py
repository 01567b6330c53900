"""Keeping a second run out of what one is writing, and telling dead writers from living ones."""

import errno
import hashlib
import os
import shutil
import stat
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path

_WITHOUT_LOCKS = (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK)
"""Of file systems without locks, such as Lustre in its default form."""
_PREFIX, _SUFFIX = ".instok3d-", ".part"
_LOCK = "lock"
_SET_ASIDE = "old"
_MOST_WRITERS = 1000
"""Of one path at the same time."""


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
    try:
        held = _locked(lock)
    except _NoLocksError:
        warnings.warn(
            f"the disk of {lock.parent} has no locks; see to it that no other run writes there",
            stacklevel=3,
        )
        yield
        return
    if held is None:
        raise ValueError(refusal)
    try:
        yield
    finally:
        _unlock(lock, held)


@contextmanager
def workplace(target: Path) -> Iterator[Path]:
    """A hidden folder beside `target` to make it in; gone after the block, whatever happens.

    It is locked as long as its owner lives. What a killed owner left is removed when the same
    target is written again, and by `remove_leftovers`; what `set_aside` had moved comes back then.
    """
    try:
        place, lock = _free_place(target)
    except _NoLocksError:
        place = Path(tempfile.mkdtemp(prefix=_PREFIX, suffix=_SUFFIX, dir=target.parent))
        lock = None
    try:
        yield place
    finally:
        _close(place, lock)


def set_aside(path: Path, place: Path) -> None:
    """Move a folder into a workplace. It comes back unless something else takes its place."""
    (place / _SET_ASIDE).mkdir()
    path.rename(place / _SET_ASIDE / path.name)


def bring_back(path: Path) -> None:
    """Undo a replacement of `path` whose process died between its two renames, if there is one.

    Only file systems on which two names cannot be exchanged at once need it.
    """
    for aside in path.parent.glob(f"{_PREFIX}*{_SUFFIX}/{_SET_ASIDE}/*"):
        if aside.name == path.name and not os.path.lexists(path):
            place = aside.parents[1]
            try:
                if (lock := _take(place)) is not None:
                    _close(place, lock)
            except _NoLocksError:
                aside.rename(path)


def remove_leftovers(folder: Path) -> None:
    """Remove the workplaces of dead processes from a folder; living ones keep theirs."""
    with suppress(_NoLocksError):
        for place in sorted(folder.glob(f"{_PREFIX}*{_SUFFIX}")):
            if (lock := _take(place)) is not None:
                _close(place, lock)


class _NoLocksError(Exception):
    """The file system has no locks."""


def _free_place(target: Path) -> tuple[Path, FileIO]:
    """A locked, empty workplace. Those that dead processes left for the same target are removed."""
    found: tuple[Path, FileIO] | None = None
    digest = hashlib.sha256(os.fsencode(target.name)).hexdigest()[:12]
    for number in range(_MOST_WRITERS):
        place = target.parent / f"{_PREFIX}{digest}-{number}{_SUFFIX}"
        if found is not None and not place.exists():
            return found
        if (lock := _take(place)) is None:
            continue
        if found is None and _is_cleared(place):
            found = place, lock
        else:
            _close(place, lock)
    raise ValueError(f"{_MOST_WRITERS} other runs are writing {target}; wait for their end")


def _take(place: Path) -> FileIO | None:
    """The lock of a workplace, which is made if it is not there; None where another holds it."""
    while True:
        made = True
        try:
            place.mkdir()
        except FileExistsError:
            made = False
            # In a folder that everybody may write to, what others made is left alone.
            if not _is_own_folder(place):
                return None
        try:
            return _locked(place / _LOCK)
        except FileNotFoundError:  # its owner ended just now
            continue
        except _NoLocksError:
            if made:
                place.rmdir()
            raise


def _is_own_folder(place: Path) -> bool:
    try:
        about = place.lstat()
    except FileNotFoundError:
        return True
    return stat.S_ISDIR(about.st_mode) and (os.name == "nt" or about.st_uid == os.geteuid())


def _close(place: Path, lock: FileIO | None) -> None:
    """Remove a workplace and give up its lock."""
    try:
        _remove(place, lock)
    except BaseException:  # such as a second Ctrl-C: nothing is left all the same
        _remove(place, lock)
        raise


def _remove(place: Path, lock: FileIO | None) -> None:
    _is_cleared(place)
    if lock is not None:
        _unlock(place / _LOCK, lock)
    with suppress(OSError):  # another process may have come in, or something cannot be removed
        place.rmdir()


def _is_cleared(place: Path) -> bool:
    """Bring back what was set aside, remove all else but the lock; whether that was possible."""
    for aside in place.glob(f"{_SET_ASIDE}/*"):
        if not os.path.lexists(place.parent / aside.name):
            aside.rename(place.parent / aside.name)
    for path in place.glob("*"):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        elif path.name != _LOCK:
            with suppress(OSError):
                path.unlink()
    return all(path.name == _LOCK for path in place.glob("*"))


def _locked(path: Path) -> FileIO | None:
    """A lock file, made if it is not there, open; None where another process holds it."""
    try:
        import fcntl
    except ModuleNotFoundError as error:  # on Windows
        raise _NoLocksError from error
    lock = FileIO(os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666), "r+")
    held = False
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # A run that ended since the file was opened has removed it: no lock on that counts.
        held = os.path.samestat(os.fstat(lock.fileno()), path.stat())
    except (BlockingIOError, FileNotFoundError):
        pass
    except OSError as error:
        if error.errno not in _WITHOUT_LOCKS:
            raise
        path.unlink(missing_ok=True)
        raise _NoLocksError from error
    finally:
        if not held:
            lock.close()
    return lock if held else None


def _unlock(path: Path, lock: FileIO) -> None:
    if not lock.closed:
        path.unlink(missing_ok=True)
        lock.close()
