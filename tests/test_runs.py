"""The scripts in runs/ call commands that exist, in an order that works, and can be resumed."""

import os
import subprocess
from pathlib import Path

import pytest

from command_lines import parses

SCRIPT = Path(__file__).resolve().parents[1] / "runs" / "default_model.sh"
RECORDER = """#!/usr/bin/env bash
printf '%s\\0' "$@" >>"$RECORD"; printf '\\n' >>"$RECORD"
"""


def recorded(tmp_path: Path) -> list[list[str]]:
    """The commands that the script would run."""
    stand_in = tmp_path / "bin" / "instok3d"
    stand_in.parent.mkdir(exist_ok=True)
    stand_in.write_text(RECORDER)
    stand_in.chmod(0o755)
    record = tmp_path / "record"
    record.unlink(missing_ok=True)
    environment = os.environ | {
        "PATH": f"{stand_in.parent}{os.pathsep}{os.environ['PATH']}", "RECORD": str(record),
    }  # fmt: skip
    subprocess.run(["bash", SCRIPT, tmp_path / "my run"], env=environment, check=True)
    return [line.split("\0")[:-1] for line in record.read_text().splitlines()]


def test_the_script_of_the_default_model_runs_commands_that_exist(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    commands = recorded(tmp_path)
    stages = [words[:2] for words in commands]
    training = ["nano-geometry", "nano-tokenizer", "export"]
    assert stages[:5] == [["data", "rooms"]] * 2 + [["train", name] for name in training]
    modes = [(words[1], words[words.index("--geometry") + 1]) for words in commands[5:]]
    assert len(set(modes)) == 4
    for words in commands:
        with monkeypatch.context() as patch:
            assert parses(words, patch), words


def test_the_script_goes_on_with_runs_that_have_a_checkpoint(tmp_path: Path):
    assert not any("--resume" in words for words in recorded(tmp_path))
    checkpoints = tmp_path / "my run" / "geometry" / "checkpoints"
    checkpoints.mkdir(parents=True)
    (checkpoints / "step_00000100.pt").touch()
    resumed = [words[1] for words in recorded(tmp_path) if "--resume" in words]
    assert resumed == ["nano-geometry"]
