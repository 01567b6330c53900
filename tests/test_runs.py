"""The scripts in runs/ call commands that exist, in an order that works, and can be resumed."""

import os
import subprocess
from pathlib import Path

import pytest

from command_lines import parses

RUNS = Path(__file__).resolve().parents[1] / "runs"
RECORDER = """#!/usr/bin/env bash
printf '%s\\0' "$@" >>"$RECORD"; printf '\\n' >>"$RECORD"
"""


def recorded(tmp_path: Path, script: str, *arguments: str) -> list[list[str]]:
    """The commands that a script would run, without what stands before `instok3d` in them."""
    folder = tmp_path / "bin"
    folder.mkdir(exist_ok=True)
    for name in ("instok3d", "python", "torchrun"):
        (folder / name).write_text(RECORDER)
        (folder / name).chmod(0o755)
    record = tmp_path / "record"
    record.unlink(missing_ok=True)
    environment = os.environ | {
        "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}", "RECORD": str(record),
    }  # fmt: skip
    subprocess.run(
        ["bash", RUNS / script, tmp_path / "my run", *arguments],
        env=environment, check=True, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    commands = [line.split("\0")[:-1] for line in record.read_text().splitlines()]
    return [words[words.index("instok3d") + 1 :] if "instok3d" in words else words
            for words in commands]  # fmt: skip


def test_the_script_of_the_default_model_runs_commands_that_exist(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    commands = recorded(tmp_path, "default_model.sh")
    stages = [words[:2] for words in commands]
    training = ["nano-geometry"] * 2 + ["nano-refinement"] + ["nano-tokenizer"] * 2 + ["export"]
    assert stages[:8] == [["data", "rooms"]] * 2 + [["train", name] for name in training]
    modes = [(words[1], words[words.index("--geometry") + 1]) for words in commands[8:]]
    assert len(set(modes)) == 4
    for words in commands:
        with monkeypatch.context() as patch:
            assert parses(words, patch), words


def test_the_script_goes_on_with_runs_that_have_a_checkpoint(tmp_path: Path):
    assert not any("--resume" in words for words in recorded(tmp_path, "default_model.sh"))
    checkpoints = tmp_path / "my run" / "geometry" / "checkpoints"
    checkpoints.mkdir(parents=True)
    (checkpoints / "step_00000100.pt").touch()
    commands = recorded(tmp_path, "default_model.sh")
    resumed = [words[1] for words in commands if "--resume" in words]
    assert resumed == ["nano-geometry"]


@pytest.mark.parametrize("size", [[], ["--small"]])
def test_the_rehearsal_runs_commands_that_exist_in_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: list[str]
):
    commands = recorded(tmp_path, "rehearsal.sh", *size)
    written = [words for words in commands if words[0].endswith("rooms_as_scannet.py")]
    assert len(written) == 1
    commands.remove(written[0])
    assert [words[:2] for words in commands] == [
        ["data", "rooms"], ["data", "prepare"], ["data", "verify"], ["train", "nano-adapt"],
        ["train", "cache"], ["train", "nano-tokenizer"], ["train", "nano-tokenizer"],
        ["train", "export"], ["evaluate", "scannet-2view"],
    ]  # fmt: skip
    assert "--resume" in commands[6]
    for words in commands:
        with monkeypatch.context() as patch:
            assert parses(words, patch), words


def test_the_rehearsal_refuses_other_options(tmp_path: Path):
    ended = subprocess.run(
        ["bash", RUNS / "rehearsal.sh", tmp_path / "new", "--tiny"],
        capture_output=True,
        check=False,
    )
    assert ended.returncode == 2
    assert not (tmp_path / "new").exists()
