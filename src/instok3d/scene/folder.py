"""Writing a whole folder so that it is there complete or not at all."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing_folder(path: Path) -> Iterator[Path]:
    """A temporary folder beside `path` that takes its place when the block ends without error.

    Everything is on the disk before the name changes. A folder that is already at `path` stays
    until the new one is complete, and comes back if the last step fails. After an error, and
    after Ctrl-C, the temporary folder is gone and `path` is as it was.
    """
    part = Path(tempfile.mkdtemp(prefix=".instok3d-", suffix=".part", dir=path.parent))
    old = part.with_suffix(".old")
    try:
        yield part
        umask = os.umask(0)
        os.umask(umask)
        part.chmod(0o777 & ~umask)  # mkdtemp makes private folders
        for item in [*part.rglob("*"), part]:
            _sync(item)
        if path.exists():
            path.rename(old)
        part.rename(path)
        _sync(path.parent)
    except BaseException as error:
        if isinstance(error, OSError) and error.filename is None:
            error.filename = str(path)  # a full disk is reported without the name of the file
        if old.exists() and not path.exists():
            old.rename(path)
        raise
    finally:
        shutil.rmtree(part, ignore_errors=True)
        if old.exists() and path.exists():
            shutil.rmtree(old)


def _sync(path: Path) -> None:
    if path.is_dir() and os.name == "nt":  # Windows has no handle of a folder to sync
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
