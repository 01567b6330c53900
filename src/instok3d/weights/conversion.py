"""Checkpoints of others (.pt, .pth, .ckpt) into safetensors files.

A checkpoint is a pickle, and a pickle is a program. It is read in a process of its own by torch's
reader for weights alone, which makes tensors and plain containers and refuses all else.
"""

import errno
import json
import re
import subprocess
import sys
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from instok3d.files import replacing
from instok3d.reading import UNREADABLE, reason_of

if TYPE_CHECKING:
    import torch

MOST_REPETITION = 64
"""Tensors may share memory in a checkpoint, and are whole in a safetensors file: no more than so
many times its size."""


TRAINERS = ("pytorch_lightning.", "lightning.")
"""Packages whose classes in a checkpoint are read as plain dictionaries instead of refused."""


@dataclass(frozen=True)
class Conversion:
    """What was written."""

    tensors: int
    bytes: int
    sha256: str
    level: str
    """Keys under which the tensors lay in the checkpoint, joined by dots; empty at the top."""
    left_out: tuple[str, ...]
    """What lay beside the tensors and is no tensor."""


def convert_checkpoint(
    checkpoint: Path, output: Path, *, level: str | None = None, overwrite: bool = True
) -> Conversion:
    """Write the tensors of a checkpoint as a safetensors file, atomically.

    Args:
        checkpoint: A file of torch.save, of any age.
        output: The file to write.
        level: Keys under which the tensors lie, joined by dots, where there is more than one such
            place; empty for those at the top.
        overwrite: Replace a file that is there.

    Raises:
        FileExistsError: A file is there, and overwrite is off.
        FileNotFoundError: There is no such checkpoint.
        ValueError: It is none, it holds more than tensors and plain values, or it is not clear
            which of its tensors are meant.
        MemoryError: It does not fit in memory.
    """
    if not checkpoint.is_file():
        raise FileNotFoundError(f"no checkpoint {checkpoint}")
    with replacing(output, overwrite=overwrite) as part:
        chosen = [] if level is None else [level]
        command = [sys.executable, "-m", __name__, str(checkpoint), str(part), *chosen]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode < 0:
            raise MemoryError(
                f"reading {checkpoint} was ended by signal {-done.returncode}: too little memory?"
            )
        try:
            answer = json.loads(done.stdout.splitlines()[-1])
        except (IndexError, json.JSONDecodeError) as error:
            raise ValueError(
                f"{checkpoint} could not be read: {' '.join(done.stderr.split())[-300:]}"
            ) from error
        if "refused" in answer:
            raise ValueError(f"{checkpoint} {answer['refused']}")
    return Conversion(**{**answer, "left_out": tuple(answer["left_out"])})


def tensor_levels(content: Any, above: str = "") -> dict[str, Mapping[str, Any]]:
    """The dictionaries inside a checkpoint that hold tensors, by their keys joined by dots.

    One that stands in several places has the name of the first.
    """
    import torch

    found: dict[str, Mapping[str, Any]] = {}
    seen: set[int] = set()  # a pickle may share a dictionary, or hold one in itself
    waiting = [(above, content)]
    while waiting:
        name, level = waiting.pop()
        if not isinstance(level, Mapping) or id(level) in seen:
            continue
        seen.add(id(level))
        if any(isinstance(value, torch.Tensor) for value in level.values()):
            found[name] = level
        inner = [(f"{name}.{key}" if name else str(key), each) for key, each in level.items()]
        waiting += reversed(inner)
    return found


def convert_here(checkpoint: Path, output: Path, level: str | None = None) -> Conversion:
    """What `convert_checkpoint` does, in this process; the message lacks the file's name.

    Raises:
        ValueError: As there.
    """
    from instok3d.weights.writing import write_tensors

    levels = tensor_levels(_read(checkpoint))
    # An optimizer's state has one dictionary of tensors for each parameter, under its number.
    levels = {name: each for name, each in levels.items() if not _is_optimizer(name)}
    if not levels:
        raise ValueError("holds no tensors under names")
    if level is None and len(levels) > 1:
        raise ValueError(
            f"holds tensors in more than one place, {_names(levels)}: choose with --level"
        )
    if level is None:
        level = next(iter(levels))
    if level not in levels:
        raise ValueError(f"has no tensors under {level!r}; there are some under {_names(levels)}")
    import torch

    chosen = levels[level]
    tensors = {str(key): value for key, value in chosen.items() if isinstance(value, torch.Tensor)}
    _check_bytes(tensors, checkpoint)
    sha256 = write_tensors(output, tensors)
    return Conversion(
        tensors=len(tensors),
        bytes=output.stat().st_size,
        sha256=sha256,
        level=level,
        left_out=tuple(str(key) for key in chosen if str(key) not in tensors),
    )


def _check_bytes(tensors: Mapping[str, "torch.Tensor"], checkpoint: Path) -> None:
    """Fail where tensors are far larger than their file: strides of 0 repeat a value for ever."""
    wanted = sum(value.numel() * value.element_size() for value in tensors.values())
    most = MOST_REPETITION * checkpoint.stat().st_size
    if wanted > most:
        raise ValueError(
            f"asks for {wanted} bytes of tensors and has {checkpoint.stat().st_size} itself, far "
            "too few: it is damaged, or made to fill the disk"
        )


def _read(checkpoint: Path) -> Any:
    import pickle
    import zipfile

    import torch

    # Only the newer, zipped files can be mapped instead of read.
    mapped = zipfile.is_zipfile(checkpoint)
    try:
        with torch.serialization.safe_globals(_stand_ins(checkpoint) if mapped else []):
            return torch.load(checkpoint, map_location="cpu", weights_only=True, mmap=mapped)
    except pickle.UnpicklingError as error:
        raise ValueError(
            "is refused, it holds more than tensors and plain values (or is no checkpoint)"
            f"{_found(error)}"
        ) from error
    except MemoryError as error:  # what a damaged length asks for
        raise ValueError("is not a whole checkpoint, or needs more memory than there is") from error
    except UNREADABLE as error:
        # EINVAL is what a cut zip gives.
        if isinstance(error, OSError) and error.errno not in (None, errno.EINVAL):
            raise
        raise ValueError(f"is not a whole checkpoint: {reason_of(error)}") from error


def _stand_ins(checkpoint: Path) -> list[Any]:
    """Plain dictionaries in place of the classes of a trainer that a checkpoint names.

    PyTorch Lightning before 1.5 keeps the state of each callback under the callback's class, so
    that the class is named in checkpoints such as LSeg's. The package itself is never imported.
    """
    import torch

    names = torch.serialization.get_unsafe_globals_in_checkpoint(checkpoint)
    return [(OrderedDict, name) for name in names if name.startswith(TRAINERS)]


def _found(error: Exception) -> str:
    """What torch found in the file, without its advice on how to run it all the same."""
    reason = " ".join(str(error).split())
    found = re.search(
        r"([Uu]nsupported|unrecognized) .*?(?=\.? Please|\.? Check the doc|$)", reason
    )
    return f": {found[0][:300]}" if found else ""


def _is_optimizer(name: str) -> bool:
    return any(part.startswith("optimizer") for part in name.split("."))


def _names(levels: Mapping[str, object]) -> str:
    return ", ".join(repr(name) if name else "'' (the top)" for name in levels)


if __name__ == "__main__":
    try:
        answer = asdict(convert_here(Path(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:]))
    except ValueError as refusal:
        answer = {"refused": str(refusal)}
    print(json.dumps(answer))
