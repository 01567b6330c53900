"""Damaged versions of files, and what a reader may do with them: read, or refuse in one line."""

import contextlib
import copy
import io
import json
import random
import resource
import signal
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import patience

SPARE_BYTES = 2 * 2**30
"""No reader of these small files needs more."""
NASTY: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 3, 2**31, 2**63 - 1, -(2**63), 10**30, 0.0, -0.5, 1e-320, 1e38,
    1e308, float("nan"), float("inf"), "", "x", "../x", "\0", "1", "\ud800", [], {}, [[]], [None],
    [1, 2], [1e308] * 16, {"x": 1}, [[0.0] * 4] * 4, [[0.0] * 3] * 3, "x" * 5000, [[[[[[]]]]]],
)  # fmt: skip
Damage = Callable[[bytes, random.Random], bytes]


def survive(
    file: Path, read: Callable[[], object], damage: Damage, count: int, seed: int = 0
) -> list[str]:
    """Damage a file in many ways and read it each time; it is whole again afterwards.

    Returns:
        The message of each refusal.

    Raises:
        AssertionError: Another error, one of several lines, or one that names no file.
    """
    whole, rng, messages = file.read_bytes(), random.Random(f"{seed} {file.name}"), []
    try:
        for number in range(count):
            data = damage(whole, rng)
            file.write_bytes(data)
            message = refusal(file, read, f"{damage.__name__} {number}")
            messages += [] if message is None else [message]
    finally:
        file.write_bytes(whole)
    return messages


def refusal(file: Path, read: Callable[[], object], what: str) -> str | None:
    """The reader's one sentence about a damaged file; None where it took the file."""
    found: Exception | None = None
    try:
        with limits(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read()
    except Exception as error:
        found = error
    if found is None:
        return None
    message = str(found.args[0] if isinstance(found, KeyError) else found)
    kind = isinstance(found, ValueError | KeyError | OSError)
    if not kind or file.name not in message or "\n" in message or len(message) > 1000:
        raise AssertionError(f"{what} of {file.name}: {found!r}") from found
    return message


@contextlib.contextmanager
def limits() -> Iterator[None]:
    """An error in place of a hang or a huge allocation."""

    def late(*_: object) -> None:
        raise RuntimeError("it hangs")

    pages = int(Path("/proc/self/statm").read_text().split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = pages * resource.getpagesize() + SPARE_BYTES
    before = signal.signal(signal.SIGALRM, late)
    resource.setrlimit(resource.RLIMIT_AS, (most, hard))
    signal.alarm(patience.SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.signal(signal.SIGALRM, before)


def of_bytes(data: bytes, rng: random.Random) -> bytes:
    """Cut off, bytes changed, blocks removed, doubled, blanked or inserted."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        last = len(changed) if rng.random() < 0.5 else min(512, len(changed))  # headers are short
        start = rng.randrange(last + 1)
        end = min(len(changed), start + rng.choice((1, 1, 2, 4, 8, 64, 1000)))
        kind = rng.randrange(6)
        if kind == 0:
            del changed[start:]
        elif kind == 1:
            del changed[start:end]
        elif kind == 2:
            changed[start:start] = changed[start:end]
        elif kind == 3:
            changed[start:end] = rng.choice((b"\0", b"\xff", b"\x7f", b" ", b"9")) * (end - start)
        elif kind == 4:
            changed[start:start] = rng.randbytes(rng.choice((1, 4, 100)))
        elif start < len(changed):
            changed[start] ^= rng.choice((1, 16, 128, 255))
    return bytes(changed)


def of_json(data: bytes, rng: random.Random) -> bytes:
    """One or some values of a JSON file replaced, removed, doubled; or as `of_bytes`."""
    if rng.random() < 0.15:
        return of_bytes(data, rng)
    if rng.random() < 0.02:
        return b"[" * 100_000
    root = [json.loads(data)]
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        _change(root, rng)
    text = json.dumps(root[0])
    if rng.random() < 0.05 and "{" in text:
        text = text.replace("{", '{"version": 1, "version": 2, "format": 1, ', 1)
    return text.encode()


def changed_value(value: Any, rng: random.Random) -> Any:
    """The value with one place in it changed."""
    root = [copy.deepcopy(value)]
    _change(root, rng)
    return root[0]


def _change(root: list[Any], rng: random.Random) -> None:
    """Change one place in the value that a list holds."""
    holder, key = rng.choice(_places(root))
    old, kind = holder[key], rng.randrange(10)
    if kind == 0 and holder is not root:
        del holder[key]
    elif kind == 1 and isinstance(holder, list) and holder is not root:
        holder.insert(key, copy.deepcopy(old))
    elif kind == 2 and isinstance(holder, dict):
        holder[f"{key}x"] = holder.pop(key)
    elif kind == 3 and type(old) in (int, float):
        holder[key] = rng.choice((old + 1, -old, old * 1000, str(old)))
    else:
        holder[key] = copy.deepcopy(rng.choice(NASTY))


def _places(root: list[Any]) -> list[tuple[Any, Any]]:
    """Every place in a value of JSON, as what holds it and its key."""
    found: list[tuple[Any, Any]] = []
    ahead: list[tuple[Any, Any]] = [(root, 0)]
    while ahead:
        holder, key = ahead.pop()
        found.append((holder, key))
        inner = holder[key]
        if isinstance(inner, list | dict):
            keys = range(len(inner)) if isinstance(inner, list) else inner
            ahead += [(inner, each) for each in reversed(keys)]
    return found


def of_safetensors(data: bytes, rng: random.Random) -> bytes:
    """The header's JSON changed, that in its metadata too, or as `of_bytes`."""
    if rng.random() < 0.3:
        return of_bytes(data, rng)
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    metadata = header.get("__metadata__", {})
    if metadata and rng.random() < 0.5:
        key = rng.choice(sorted(metadata))
        old = metadata[key]
        metadata[key] = (
            of_json(old.encode(), rng).decode(errors="replace")
            if old[:1] in "[{"
            else rng.choice(("", "{}", "null", "1"))
        )
    else:
        header = changed_value(header, rng)
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + data[8 + length :]


def of_zip(data: bytes, rng: random.Random) -> bytes:
    """One member changed, with the right checksum, removed or doubled; or as `of_bytes`."""
    if rng.random() < 0.3:
        return of_bytes(data, rng)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {item.filename: archive.read(item) for item in archive.infolist()}
    name = rng.choice(sorted(members))
    if rng.random() < 0.1:
        del members[name]
    else:
        members[name] = of_bytes(members[name], rng)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for each, content in members.items():
            archive.writestr(each, content)
    return stream.getvalue()
