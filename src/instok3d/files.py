"""Writing files and folders so that a reader sees the old or the new one, never half of either."""

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from instok3d.locking import set_aside, workplace
from instok3d.renames import exchange, rename_to_free

if TYPE_CHECKING:
    from torch import Tensor


@contextmanager
def replacing(path: Path, *, overwrite: bool = True) -> Iterator[Path]:
    """A temporary path of the same name that takes the place of `path` when the block has ended.

    The data is on the disk before the name changes (fsync, then rename). After an error, and
    after Ctrl-C, the temporary file is gone and `path` is as it was. Of a process that is killed
    a hidden folder stays, which the next one that writes `path` removes.

    Args:
        path: The file to be. Its folder must be there.
        overwrite: Replace a file that is there by the end of the block.

    Raises:
        FileExistsError: A file is there, and overwrite is off; or it is a device or the like.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise FileExistsError(f"{path} is no regular file and will not be replaced")
    with workplace(path) as place:
        part = _new(place) / path.name
        yield part
        _sync(part)
        if overwrite:
            part.replace(path)
        else:
            rename_to_free(part, path)


@contextmanager
def replacing_folder(path: Path, *, overwrite: bool = True) -> Iterator[Path]:
    """A temporary folder that takes the place of `path` when the block has ended without error.

    Everything is on the disk before the name changes. Where the file system can, old and new
    exchange their names in one step; where it cannot, and the process dies between two renames,
    the old folder comes back when the next one writes `path` or calls `bring_back`. After an
    error, and after Ctrl-C, the temporary folder is gone and `path` is as it was.

    Args:
        path: The folder to be.
        overwrite: Replace a folder that is there by the end of the block.

    Raises:
        FileExistsError: Something is there, and overwrite is off or it is no folder.
    """
    if path.exists() and not path.is_dir():
        raise FileExistsError(f"{path} is no folder and will not be replaced")
    with _naming_full_disk(path), workplace(path) as place:
        part = _new(place) / path.name
        part.mkdir()
        yield part
        for item in [*part.rglob("*"), part]:
            _sync(item)
        if not (overwrite and os.path.lexists(path)):
            rename_to_free(part, path)
        elif not exchange(part, path):
            set_aside(path, place)
            part.rename(path)
        _sync(path.parent)


@contextmanager
def _naming_full_disk(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno is not None and error.filename is None:
            error.filename = str(path)  # a full disk is reported without the name of the file
        raise


def _new(place: Path) -> Path:
    (place / "new").mkdir()
    return place / "new"


def _sync(path: Path) -> None:
    if path.is_dir() and os.name == "nt":  # Windows has no handle of a folder to sync
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def write_json(path: Path, value: Any) -> None:
    """Write finite JSON, indented, atomically.

    Raises:
        ValueError: The value holds a NaN or an infinity.
    """
    text = json.dumps(value, indent=2, allow_nan=False) + "\n"
    with replacing(path) as part:
        part.write_text(text)


def json_text(value: Any, *, encoding: str = "utf-8") -> str:
    """Finite JSON with sorted keys, its characters as they are where the encoding has them all.

    Raises:
        ValueError: The value holds a NaN or an infinity.
    """
    text = json.dumps(value, indent=1, sort_keys=True, allow_nan=False, ensure_ascii=False)
    try:
        text.encode(encoding)
    except UnicodeEncodeError:  # file names may hold bytes that are no text in any encoding
        return json.dumps(value, indent=1, sort_keys=True, allow_nan=False)
    return text


def write_safetensors(
    path: Path, tensors: "Mapping[str, Tensor]", metadata: Mapping[str, str] | None = None
) -> None:
    """Write tensors atomically; equal tensors and metadata give equal bytes.

    Not `save_file`: it hides a full disk behind an error type of its own, and it shuffles the
    metadata from call to call.
    """
    data = safetensors_bytes(tensors, metadata)
    with replacing(path) as part:
        part.write_bytes(data)


def safetensors_bytes(
    tensors: "Mapping[str, Tensor]", metadata: Mapping[str, str] | None = None
) -> bytes:
    """The safetensors file of some tensors; equal tensors and metadata give equal bytes."""
    from safetensors.torch import save  # brings torch, which `instok3d --help` need not wait for

    contiguous = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    data = save(contiguous, dict(metadata) if metadata else None)
    return _with_ordered_metadata(data) if metadata else data


def _with_ordered_metadata(data: bytes) -> bytes:
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)  # tensors start at multiples of 8
    return len(text).to_bytes(8, "little") + text + data[8 + length :]
