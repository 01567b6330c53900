"""The demo's scene as `instok3d demo` makes it, once for all tests that look at it."""

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

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
    scene, out, err = folder / "demo.itk", io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main(["demo", "-o", str(scene), "--json"])
    assert code == 0, err.getvalue()
    return ShippedDemo(scene, json.loads(out.getvalue()), err.getvalue())
