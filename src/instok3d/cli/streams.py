"""Standard streams: neither a closed one nor a name that it cannot show may stop the work."""

import errno
import io
import os
import sys
from collections.abc import Collection
from typing import Any

READER_GONE = (errno.EPIPE, errno.EIO)
"""The pipe is closed (`| head`), or the terminal: nobody waits for the rest."""
LOST_NOTES = (*READER_GONE, errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""On stderr a full disk loses only notes."""


class Outlet(io.TextIOWrapper):
    """A standard stream that takes everything once its reader is gone.

    Errors are met here and not where bytes are written: a signal's exception in Python code between
    a write and the buffer that waits for its answer would have the buffer write the same again.
    """

    def __init__(self, number: int, ignored: Collection[int], **options: Any):
        super().__init__(io.BufferedWriter(io.FileIO(number, "w", closefd=False)), **options)
        self._ignored = ignored

    def write(self, text: str, /) -> int:
        """As `TextIOWrapper.write`; after an error everything more goes to the null device.

        Raises:
            OSError: Of a kind that is not ignored.
        """
        try:
            return super().write(text)
        except OSError as error:
            self._lose(error)
            return len(text)

    def flush(self) -> None:
        """As `TextIOWrapper.flush`, with the errors of `write`."""
        try:
            super().flush()
        except OSError as error:
            self._lose(error)

    def _lose(self, error: OSError) -> None:
        _to_null_device(self.fileno())
        if error.errno not in self._ignored:
            raise error


def keep_streams() -> None:
    """Make the three streams of this process safe to write to; changes nothing the second time.

    A stream that the caller closed becomes the null device: otherwise the next file that is opened
    gets its number, and what a library prints goes into that file. Characters that the encoding of
    a stream lacks, and bytes of file names that are no text, are written as escapes.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            _to_null_device(number)
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, os.fdopen(number, mode, encoding="utf-8", closefd=False))
            setattr(sys, f"__{name}__", getattr(sys, name))
    for name, ignored in (("stdout", READER_GONE), ("stderr", LOST_NOTES)):
        stream = getattr(sys, name)
        # Streams that a program put in their place, such as a notebook or a test, stay.
        if stream is getattr(sys, f"__{name}__") and isinstance(stream, io.TextIOWrapper):
            stream.flush()
            safe = Outlet(
                stream.fileno(),
                ignored,
                encoding=stream.encoding,
                errors="backslashreplace",
                line_buffering=stream.line_buffering or stream.write_through,
            )
            setattr(sys, name, safe)


def _to_null_device(number: int) -> None:
    null = os.open(os.devnull, os.O_RDWR)
    if null == number:
        os.set_inheritable(null, True)
    else:
        os.dup2(null, number)
        os.close(null)
