"""Whether the real command line takes a command that a page or a script writes."""

import functools
from collections.abc import Callable
from importlib import import_module

import pytest

from instok3d.cli import main


def parses(words: list[str], monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether `instok3d` takes these words; the command itself does not run."""
    module = import_module(f"instok3d.cli.{words[0]}")
    ran = []

    def stand_in(function: Callable) -> Callable:
        return functools.wraps(function)(lambda *_, **__: ran.append(function))

    if hasattr(module, "COMMANDS"):
        real = module.subcommand
        monkeypatch.setattr(module, "subcommand", lambda name: stand_in(real(name)))
    else:
        monkeypatch.setattr(module, "run", stand_in(module.run))
    return main(words) == 0 and len(ran) == 1
