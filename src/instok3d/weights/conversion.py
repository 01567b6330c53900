"""Checkpoints of others (.pt, .pth, .ckpt) into safetensors files.

A checkpoint is a pickle, and a pickle is a program. It is read in a process of its own by torch's
reader for weights alone, which makes tensors and plain containers and refuses all else.
"""

import errno
import json
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from instok3d.files import replacing


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
                f"{checkpoint} could not be read: {done.stderr.strip()[-500:]}"
            ) from error
        if "refused" in answer:
            raise ValueError(f"{checkpoint} {answer['refused']}")
    return Conversion(**{**answer, "left_out": tuple(answer["left_out"])})


def tensor_levels(content: Any, above: str = "") -> dict[str, Mapping[str, Any]]:
    """The dictionaries inside a checkpoint that hold tensors, by their keys joined by dots."""
    import torch

    if not isinstance(content, Mapping):
        return {}
    found = {}
    if any(isinstance(value, torch.Tensor) for value in content.values()):
        found[above] = content
    for key, value in content.items():
        found |= tensor_levels(value, f"{above}.{key}" if above else str(key))
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
    sha256 = write_tensors(output, tensors)
    return Conversion(
        tensors=len(tensors),
        bytes=output.stat().st_size,
        sha256=sha256,
        level=level,
        left_out=tuple(str(key) for key in chosen if str(key) not in tensors),
    )


def _read(checkpoint: Path) -> Any:
    import pickle
    import zipfile

    import torch

    # Only the newer, zipped files can be mapped instead of read.
    mapped = zipfile.is_zipfile(checkpoint)
    try:
        return torch.load(checkpoint, map_location="cpu", weights_only=True, mmap=mapped)
    except pickle.UnpicklingError as error:
        raise ValueError(
            "is refused, it holds more than tensors and plain values (or is no checkpoint)"
            f"{_found(error)}"
        ) from error
    except (RuntimeError, EOFError, ValueError, KeyError, OSError) as error:
        if isinstance(error, OSError) and error.errno != errno.EINVAL:  # what a cut zip gives
            raise
        reason = " ".join(str(error).split())[:300] or type(error).__name__
        raise ValueError(f"is not a whole checkpoint: {reason}") from error


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
