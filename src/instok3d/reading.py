"""Reading files that may be damaged: JSON of sound values alone, and one error for all damage."""

import errno
import io
import json
import math
import pickle
import reprlib
import struct
import tarfile
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from safetensors import SafetensorError

UNREADABLE = (
    *(ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RuntimeError),
    *(AssertionError, EOFError, SyntaxError, OSError, struct.error, zlib.error, tarfile.TarError),
    *(zipfile.BadZipFile, tokenize.TokenError, pickle.UnpicklingError, SafetensorError),
    Image.DecompressionBombError,
)
"""What decoders raise for damaged files."""


@contextmanager
def naming_damage(what: object, remedy: str) -> Iterator[None]:
    """Whatever a decoder raises in the block becomes a ValueError that names the file.

    Errors of the system, such as a missing permission, and those that name the file already stay
    what they are.

    Args:
        what: The file, and the place in it.
        remedy: What to do about it.
    """
    try:
        yield
    except UNREADABLE as error:
        # The system's EINVAL comes from places in the file that cannot be.
        if isinstance(error, OSError) and error.errno not in (None, errno.EINVAL):
            raise
        if isinstance(error, ValueError) and str(error).startswith(str(what)):
            raise
        raise ValueError(f"{what} is damaged ({reason_of(error)}); {remedy}") from error


def reason_of(error: BaseException) -> str:
    """What an error of a decoder says, in one line of at most 300 characters."""
    words = " ".join(str(error).split())
    if isinstance(error, KeyError):
        words = f"it lacks {words}"
    elif isinstance(error, TypeError | AttributeError):
        words = f"a value in it is of another kind than wanted: {words}"
    return words[:300] or type(error).__name__


def read_json(path: Path, remedy: str) -> Any:
    """The value of a JSON file; numbers are finite and of 64 bits, a key stands once.

    Args:
        path: The file, in UTF-8 with or without a byte order mark.
        remedy: What to do about a damaged one.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged, or holds what JSON cannot.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise FileNotFoundError(f"there is no file {path}") from error
    return parse_json(data, path, remedy)


def parse_json(data: bytes | str, what: object, remedy: str) -> Any:
    """The value of JSON text, as `read_json` reads it.

    Args:
        data: The text, or its bytes in UTF-8.
        what: Where it comes from.
        remedy: What to do if it is damaged.

    Raises:
        ValueError: It is damaged, or holds what JSON cannot.
    """
    with naming_damage(what, remedy):
        content = data if isinstance(data, str) else data.decode("utf-8-sig")
        value = json.loads(
            content,
            parse_int=_integer,
            parse_float=_finite,
            parse_constant=_finite,
            object_pairs_hook=_without_doubled_keys,
        )
        if "\\ud" in content.lower():
            # Half a character stands for no text, but for a byte of a file name that is not UTF-8.
            json.dumps(value, ensure_ascii=False).encode(errors="surrogateescape")
        return value


def text(value: Any) -> str:
    """A value of JSON that is text.

    Raises:
        ValueError: It is something else.
    """
    if not isinstance(value, str):
        raise ValueError(f"{reprlib.repr(value)} is no text")
    return value


def one_line(value: Any) -> str:
    """A value of JSON that is one line of text.

    Raises:
        ValueError: It is something else.
    """
    if not text(value).isprintable() or not value.strip():
        raise ValueError(f"{value!r} is no line of text")
    return value


def parse_npy(data: bytes, what: object, remedy: str) -> np.ndarray:
    """The numbers of a .npy file, whose header is checked before anything is allocated.

    Args:
        data: The file.
        what: Where it comes from.
        remedy: What to do if it is damaged.

    Raises:
        ValueError: It is damaged, or holds other things than numbers.
    """
    stream = io.BytesIO(data)
    with naming_damage(what, remedy):
        version = np.lib.format.read_magic(stream)
        if version not in ((1, 0), (2, 0)):
            raise ValueError(f"it is of version {version}")
        first = version == (1, 0)
        read = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
        try:
            shape, by_columns, kind = read(stream)
        except MemoryError as error:  # of the parser, for nested brackets
            raise ValueError("its header is none") from error
        if kind.hasobject:
            raise ValueError("it holds other things than numbers")
        promised, found = math.prod(shape) * kind.itemsize, len(data) - stream.tell()
        if promised != found:
            raise ValueError(f"its header promises {promised} bytes, {found} are there")
        values = np.frombuffer(data, kind, offset=stream.tell())
        return values.reshape(shape, order="F" if by_columns else "C")


def open_zip(path: Path) -> zipfile.ZipFile:
    """A zip file of which no part is said to be packed in more bytes than the file has.

    Reading such a part would take that memory.

    Raises:
        ValueError: There is one.
    """
    archive, size = zipfile.ZipFile(path), path.stat().st_size
    for entry in archive.infolist():
        if entry.compress_size > size:
            archive.close()
            raise ValueError(
                f"a part of it is said to take {entry.compress_size:,} bytes of its {size:,}"
            )
    return archive


def open_png(path: Path) -> Image.Image:
    """The picture of a PNG file, not yet decoded.

    From memory: of a file Pillow would first allocate whatever size a damaged chunk promises.
    """
    return Image.open(io.BytesIO(path.read_bytes()), formats=["PNG"])


def whole_number(value: Any, least: int = 0, most: int = 2**63 - 1) -> int:
    """A value of JSON that is a whole number within bounds.

    Raises:
        ValueError: It is something else.
    """
    if type(value) is not int or not least <= value <= most:
        raise ValueError(f"{reprlib.repr(value)} is no whole number from {least} to {most}")
    return value


def whole_numbers(values: Any, count: int) -> Any:
    """Exactly `count` whole numbers as a tuple."""
    if len(values) != count:
        raise ValueError(f"wanted {count} whole numbers, got {reprlib.repr(values)}")
    return tuple(whole_number(value) for value in values)


def number(value: Any) -> float:
    """A value of JSON that is a number.

    Raises:
        ValueError: It is something else.
    """
    if type(value) not in (int, float):
        raise ValueError(f"{reprlib.repr(value)} is no number")
    return float(value)


def one_of(value: Any, choices: Sequence[Any]) -> Any:
    """A value of JSON that is one of some.

    Raises:
        ValueError: It is something else.
    """
    if value not in choices:
        raise ValueError(f"{reprlib.repr(value)} is none of {', '.join(map(repr, choices))}")
    return value


def _integer(text: str) -> int:
    if len(text) > 20 or not -(2**63) <= int(text) < 2**63:
        raise ValueError(f"the number {text[:20]}... is too large")
    return int(text)


def _finite(text: str) -> float:
    value = float(text)
    if value - value != 0:
        raise ValueError(f"the number {text[:20]} is not finite")
    return value


def _without_doubled_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) < len(pairs):
        keys = [key for key, _ in pairs]
        doubled = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {reprlib.repr(doubled)} stands twice in one object")
    return value
