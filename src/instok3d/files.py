"""Writing files so that a reader sees the old one or the new one, never half of either."""

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` that takes its place when the block ends without error.

    The data is on the disk before the name changes (fsync, then rename). After an error, and
    after Ctrl-C, the temporary file is gone and `path` is as it was.
    """
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    part = Path(name)
    try:
        yield part
        with part.open("rb") as stream:
            os.fsync(stream.fileno())
        umask = os.umask(0)
        os.umask(umask)
        part.chmod(0o666 & ~umask)  # mkstemp makes private files
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def write_json(path: Path, value: Any) -> None:
    """Write finite JSON, indented, atomically.

    Raises:
        ValueError: The value holds a NaN or an infinity.
    """
    text = json.dumps(value, indent=2, allow_nan=False) + "\n"
    with replacing(path) as part:
        part.write_text(text)
