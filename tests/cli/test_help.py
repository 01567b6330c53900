"""Help for every command, without waiting for PyTorch."""

import json
import subprocess
import sys
from importlib import import_module

import pytest

from instok3d.cli import COMMANDS, main
from instok3d.training.config import PRESETS

GROUPS = {name: getattr(import_module(f"instok3d.cli.{name}"), "COMMANDS", {}) for name in COMMANDS}
EVERY = [[], *([name] for name in COMMANDS), *([g, name] for g in GROUPS for name in GROUPS[g])]
# Their options are the settings of networks and of data sets, whose modules need PyTorch.
NEED_TORCH = [["data", "prepare"], ["train", "cache"], *(["train", name] for name in PRESETS)]


def test_help_does_not_import_torch():
    """Which takes seconds where nothing else does."""
    program = """
import json, sys
from instok3d.cli import main
for words in json.loads(sys.argv[1]):
    assert main([*words, "--help"]) == 0, words
    assert "torch" not in sys.modules, words
"""
    light = [words for words in EVERY if words not in NEED_TORCH]
    command = [sys.executable, "-c", program, json.dumps(light)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize("words", EVERY, ids=" ".join)
def test_every_command_has_help(words: list[str], capsys: pytest.CaptureFixture[str]):
    assert main([*words, "--help"]) == 0
    shown = capsys.readouterr().out
    program = " ".join(["instok3d", *words])
    assert shown.startswith(f"usage: {program} ")
    subcommands = GROUPS.get(words[0], {}) if words else COMMANDS
    assert all(f"  {name} " in shown for name in (subcommands if len(words) < 2 else ()))


def test_every_preset_can_be_trained():
    assert set(PRESETS) == set(GROUPS["train"]) - {"cache", "export"}
