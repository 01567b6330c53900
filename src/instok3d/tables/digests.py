"""Hashes of files that are asked for again and again: weights, of each cell."""

from functools import lru_cache
from pathlib import Path

from instok3d.files import sha256_of


def digest_of(path: Path) -> str:
    """SHA-256 of a file; read again only where its inode, size or time of change is another.

    Raises:
        FileNotFoundError: It is not there.
    """
    found = path.stat()
    return _digest(path, found.st_ino, found.st_size, found.st_mtime_ns)


@lru_cache(maxsize=256)
def _digest(path: Path, inode: int, size: int, changed_ns: int) -> str:
    return sha256_of(path)
