"""Writing files and folders so that a reader sees the old or the new one, never half of either."""

import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torch import Tensor


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


@contextmanager
def replacing_folder(path: Path, *, part: Path | None = None) -> Iterator[Path]:
    """A temporary folder beside `path` that takes its place when the block ends without error.

    Everything is on the disk before the name changes. A folder that is already at `path` stays
    until the new one is complete, and comes back if the last step fails. After an error, and
    after Ctrl-C, the temporary folder is gone and `path` is as it was.

    Args:
        path: The folder to be.
        part: The temporary folder, for callers of whom one at a time writes: what a killed
            process left is then cleared away. None = a hidden one with a name of its own.
    """
    if part is None:
        part = Path(tempfile.mkdtemp(prefix=".instok3d-", suffix=".part", dir=path.parent))
        old = part.with_suffix(".old")
    else:
        old = part.with_suffix(".old")
        if old.exists() and not path.exists():  # killed between the two renames
            old.rename(path)
        shutil.rmtree(old, ignore_errors=True)
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
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
        if isinstance(error, OSError) and error.errno is not None and error.filename is None:
            error.filename = str(path)  # a full disk is reported without the name of the file
        if old.exists() and not path.exists():
            old.rename(path)
        raise
    finally:
        shutil.rmtree(part, ignore_errors=True)
        if old.exists() and path.exists():
            shutil.rmtree(old)


def part_folder(path: Path) -> Path:
    """The hidden folder beside `path` in which it may grow, the same for every process."""
    return path.with_name(f".{path.name}.part")


def _sync(path: Path) -> None:
    if path.is_dir() and os.name == "nt":  # Windows has no handle of a folder to sync
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_json(path: Path, value: Any) -> None:
    """Write finite JSON, indented, atomically.

    Raises:
        ValueError: The value holds a NaN or an infinity.
    """
    text = json.dumps(value, indent=2, allow_nan=False) + "\n"
    with replacing(path) as part:
        part.write_text(text)


def write_safetensors(
    path: Path, tensors: "Mapping[str, Tensor]", metadata: Mapping[str, str] | None = None
) -> None:
    """Write tensors atomically; equal tensors and metadata give equal bytes.

    Not `save_file`: it hides a full disk behind an error type of its own, and it shuffles the
    metadata from call to call.
    """
    from safetensors.torch import save  # brings torch, which `instok3d --help` need not wait for

    contiguous = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    data = save(contiguous, dict(metadata) if metadata else None)
    if metadata:
        data = _with_ordered_metadata(data)
    with replacing(path) as part:
        part.write_bytes(data)


def _with_ordered_metadata(data: bytes) -> bytes:
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)  # tensors start at multiples of 8
    return len(text).to_bytes(8, "little") + text + data[8 + length :]
