"""The demo's scene as `instok3d demo` makes it, once for all tests of a run that look at it."""

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from filelock import FileLock

from instok3d.cli import main
from instok3d.model.files import DEFAULT_MODEL

PHOTOS = Path(str(files("instok3d") / "assets" / "demo"))


@dataclass(frozen=True)
class ShippedDemo:
    """A run of the command."""

    scene: Path
    made: dict[str, Any]
    """What it printed with --json."""
    notes: str
    """What it said on stderr."""


def is_shipped() -> bool:
    return DEFAULT_MODEL.is_file() and PHOTOS.is_dir()


def make_demo(folder: Path) -> ShippedDemo:
    """What the command made in a folder that the processes of a run share; the first one runs it.

    The scene is for reading: a test that changes it works on a copy.
    """
    scene, record = folder / "demo.itk", folder / "said.json"
    with FileLock(folder / "lock"):
        if not record.is_file():
            out, err = io.StringIO(), io.StringIO()
            with redirect_stdout(out), redirect_stderr(err):
                code = main(["demo", "-o", str(scene), "--json"])
            assert code == 0, err.getvalue()
            record.write_text(json.dumps([out.getvalue(), err.getvalue()]))
        made, notes = json.loads(record.read_text())
    return ShippedDemo(scene, json.loads(made), notes)
