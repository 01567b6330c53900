"""Teachers by their names on the command line: `--teacher clip:FOLDER`."""

from collections.abc import Callable
from pathlib import Path

import torch

from instok3d.semantics.teacher import Teacher

FORMS = ("lseg:FILE", "clip:FOLDER", "siglip2:FOLDER", "dino:FOLDER", "rooms:FILE")
"""What `open_teacher` takes."""


def open_teacher(text: str, device: torch.device | str = "cpu") -> Teacher:
    """The teacher that a text names, with its weights.

    Args:
        text: One of FORMS.
        device: Where it runs.

    Raises:
        ValueError: The text is none of these, or the weights are not what they should be.
        FileNotFoundError: There are no such weights.
        ModuleNotFoundError: The package that runs them is not installed.
    """
    kind, _, place = text.partition(":")
    kinds = {"rooms": _rooms, "lseg": _lseg, "clip": _clip, "siglip2": _siglip, "dino": _dino}
    if kind not in kinds or not place:
        raise ValueError(f"{text!r} names no teacher; wanted is one of {', '.join(FORMS)}")
    return kinds[kind]()(Path(place), device)


def _rooms() -> Callable[..., Teacher]:
    from instok3d.semantics.teachers.file import load_teacher

    return load_teacher


def _lseg() -> Callable[..., Teacher]:
    from instok3d.semantics.teachers.lseg import LSegTeacher

    return LSegTeacher


def _clip() -> Callable[..., Teacher]:
    from instok3d.semantics.teachers.pretrained import ClipTeacher

    return ClipTeacher


def _siglip() -> Callable[..., Teacher]:
    from instok3d.semantics.teachers.pretrained import SiglipTeacher

    return SiglipTeacher


def _dino() -> Callable[..., Teacher]:
    from instok3d.semantics.teachers.pretrained import DinoTeacher

    return DinoTeacher
