"""The scripts in runs/ call commands that exist, in an order that works, and can be resumed."""

import json
import os
import re
import runpy
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

import instok3d
import noise_rooms
from command_lines import parses
from instok3d.evaluation.disturbances import DISTURBANCES
from instok3d.files import write_json
from instok3d.model.files import load_model, read_card, save_model
from instok3d.rooms.seen_colors import NAMES as COLORS
from instok3d.rooms.shards import new_index
from instok3d.semantics.classes import PHRASES
from instok3d.semantics.teachers.file import load_teacher
from instok3d.semantics.text import quantized, save_table
from instok3d.semantics.wordpiece import UNKNOWN
from made_model import made_model
from noise_rooms import noise_scene

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


@pytest.mark.parametrize("mode", [[], ["--small"]])
def test_training_for_real_photos_runs_commands_that_exist_in_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: list[str]
):
    commands = recorded(tmp_path, "real_photos.sh", *mode)
    (mean,) = (words for words in commands if words[0].endswith("mean_weights.py"))
    place = commands.index(mean)
    start, end = commands[3][commands[3].index("--init-from") + 1], commands[4][-3]
    assert mean[1:3] == [start, end]
    commands.remove(mean)
    stages = [words[:2] for words in commands]
    training = ["nano-tokenizer", "export"]
    assert stages[:place] == [["data", "rooms"]] * 3 + [["train", name] for name in training]
    assert all(words[0] == "evaluate" for words in commands[place:])
    assert ["real" in words for words in commands[:3]] == [False, True, False]
    made = [words[words.index("-o") + 1] for words in commands[:2]]
    words = commands[3]
    assert words[words.index("--batches.sensor.strength") + 1] == "1"
    data = words.index("--data")
    assert words[data + 1 : data + 3] == made
    rows = [words for words in commands if "--refine" in words]
    assert sum("--disturb" in words for words in rows) == 2 * len(DISTURBANCES)
    assert len(rows) == 2 * len(DISTURBANCES) + 2
    for words in commands:
        with monkeypatch.context() as patch:
            assert parses(words, patch), words


def test_training_for_real_photos_goes_on_and_keeps_what_is_done(tmp_path: Path):
    folder = tmp_path / "my run"
    (folder / "tokenizer" / "checkpoints").mkdir(parents=True)
    (folder / "tokenizer" / "checkpoints" / "step_00000100.pt").touch()
    for name in ("real_photos.safetensors", "hard-0.md"):
        (folder / name).touch()
    commands = recorded(tmp_path, "real_photos.sh")
    assert [words[1] for words in commands if "--resume" in words] == ["nano-tokenizer"]
    assert not any("export" in words or words[0].endswith("weights.py") for words in commands)
    hard = [words for words in commands if "hard" in words]
    assert [words[words.index("--refine") + 1] for words in hard] == ["100"]


@pytest.mark.parametrize("mode", [[], ["--small"]])
def test_semantics_are_made_in_order_and_by_commands_that_exist(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: list[str]
):
    monkeypatch.setenv("MINILM", str(tmp_path))
    commands = recorded(tmp_path, "semantics.sh", *mode)
    kinds = [
        Path(words[0]).name if words[0].endswith(".py") else " ".join(words[:2])
        for words in commands
    ]
    assert kinds == [
        "data rooms", "data rooms", "data rooms", "text_table.py", "teacher.py",
        "train nano-semantics", "train export", "query_table.py", "semantic_table.py",
        "query_table.py", "query_table.py", "query_table.py",
    ]  # fmt: skip
    for words in commands:
        if words[0].endswith(".py"):
            known = Path(words[0]).read_text(encoding="utf-8")
            options = [word for word in words if re.fullmatch("-{1,2}[a-z][a-z-]*", word)]
            assert [option for option in options if f'"{option}"' not in known] == [], words
        else:
            with monkeypatch.context() as patch:
                assert parses(words, patch), words
    fitted = commands[7]
    assert fitted[-1] == "--write"
    assert fitted[fitted.index("--semantics") + 1] == commands[6][commands[6].index("-o") + 1]


def test_semantics_are_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("MINILM", str(tmp_path))
    folder = tmp_path / "my run"
    (folder / "distillation" / "checkpoints").mkdir(parents=True)
    (folder / "distillation" / "checkpoints" / "step_00000100.pt").touch()
    for name in ("table.safetensors", "semantics.safetensors", "lifting.md", "queries-4.md"):
        (folder / name).touch()
    commands = recorded(tmp_path, "semantics.sh")
    assert [words[1] for words in commands if "--resume" in words] == ["nano-semantics"]
    scripts = [Path(words[0]).name for words in commands if words[0].endswith(".py")]
    assert scripts == ["teacher.py", "query_table.py", "query_table.py"]


def test_catalogues_are_for_the_rooms_of_level_real(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("FURNITURE", "my models")
    monkeypatch.setenv("TEXTURES", "my textures")
    plain, real, tests = recorded(tmp_path, "real_photos.sh")[:3]
    assert "--furniture" not in plain + tests
    assert real[real.index("--furniture") + 1] == "my models"
    assert real[real.index("--textures") + 1] == "my textures"


def test_the_plan_of_the_training_for_real_photos_writes_nothing(tmp_path: Path):
    commands = recorded(tmp_path, "real_photos.sh", "--dry-run")
    assert [words[:2] for words in commands] == [["train", "nano-tokenizer"]]
    assert all("--dry-run" in words for words in commands)
    assert not (tmp_path / "my run").exists()


def test_the_tokenizer_of_one_model_joins_the_backbone_of_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    ones, twos, odd = (tmp_path / name for name in ("1.safetensors", "2.safetensors", "3.st"))
    one, two = torch.ones(2), torch.full((2,), 2.0)
    save_file({"anchors": one, "backbone.a": one.clone()}, ones)
    save_file({"a": two}, twos)
    save_file({"b": two}, odd)

    def join(backbone: Path) -> None:
        words = ["joined_weights.py", ones, backbone, "-o", tmp_path / "joined"]
        monkeypatch.setattr(sys, "argv", [str(word) for word in words])
        runpy.run_path(str(RUNS / "joined_weights.py"), run_name="__main__")

    join(twos)
    joined = load_file(tmp_path / "joined")
    assert {name: value.tolist() for name, value in joined.items()} == {
        "anchors": [1.0, 1.0], "backbone.a": [2.0, 2.0],
    }  # fmt: skip
    with pytest.raises(ValueError, match=r"they differ in \['backbone.a', 'backbone.b'\]"):
        join(odd)


@pytest.mark.parametrize("script", ["rehearsal.sh", "real_photos.sh"])
def test_scripts_refuse_other_options(tmp_path: Path, script: str):
    ended = subprocess.run(
        ["bash", RUNS / script, tmp_path / "new", "--tiny"], capture_output=True, check=False
    )
    assert ended.returncode == 2
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_the_embedded_teacher_is_trained_and_the_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A second of training in rooms of noise; then the finished run is taken up again."""
    write_json(tmp_path / "rooms.json", new_index(16, "mix"))
    words = {"id": 1, "class": "sofa", "color": "red", "material": "fabric", "pixels": [256] * 16}
    rooms = [noise_scene(seed) for seed in range(3)]
    noise_rooms.put(tmp_path, 0, [
        replace(each, meta=each.meta | {"instances": [words]}, instances=each.instances * 0 + 1)
        for each in rooms
    ])  # fmt: skip
    pieces = [UNKNOWN, *{piece for text in (*PHRASES, *COLORS, "fabric") for piece in text.split()}]
    torch.manual_seed(0)
    save_table(quantized(torch.randn(len(pieces), 8), pieces, "made up"), tmp_path / "table")
    start = Path(instok3d.__file__).parent / "assets" / "default_model.safetensors"
    monkeypatch.syspath_prepend(str(RUNS))
    script = import_module("teacher")
    arguments = ["--rooms", tmp_path, "--table", tmp_path / "table", "--start", start,
                 "-o", tmp_path / "run", "--minutes", "0.01", "--batch", "2"]  # fmt: skip
    for _ in range(2):
        script.main([str(each) for each in arguments])
    teacher = load_teacher(tmp_path / "run" / "teacher.safetensors")
    assert teacher.features(torch.rand(1, 3, 16, 16)).isfinite().all()
    lines = [json.loads(line) for line in (tmp_path / "run" / "log.jsonl").read_text().splitlines()]
    looks = [line for line in lines if "lsm_miou" in line]
    assert looks[0]["step"] == looks[1]["step"] > 0


def test_the_mean_of_two_models_lies_between_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(RUNS))
    script = import_module("mean_weights")
    start = made_model(tmp_path / "start.safetensors")
    end = load_model(start)
    with torch.no_grad():
        for parameter in end.parameters():
            parameter.add_(1.0)
    card = {"name": "end", "image_side": 32, "validation": {"psnr": 20}}
    save_model(end, tmp_path / "end.safetensors", card=card, half=False)
    output = tmp_path / "mean.safetensors"
    words = [
        start,
        tmp_path / "end.safetensors",
        "-o",
        output,
        "--share",
        "0.25",
        "--notes",
        "made",
    ]
    script.main([str(each) for each in words])
    mean, first = load_model(output).state_dict(), load_model(start).state_dict()
    for name, weight in load_model(start).named_parameters():
        torch.testing.assert_close(mean[name], weight + 0.25, atol=2e-3, rtol=1e-3)
    assert all(
        torch.equal(mean[name], first[name])
        for name in first
        if not first[name].is_floating_point()
    )
    assert read_card(output) == {"name": "mean", "image_side": 32, "notes": "made"}
    with pytest.raises(ValueError, match=r"differ in their tensors: \['a'\]"):
        script.mean_weights({"a": torch.ones(1)}, {"a": torch.ones(2)}, 0.5)
    with pytest.raises(ValueError, match=r"--share must lie in 0\.\.1, got 2\.0"):
        script.main([*map(str, words[:4]), "--share", "2"])


@pytest.mark.parametrize("path", sorted(RUNS.glob("*.py")), ids=lambda path: path.stem)
def test_every_script_finds_what_it_takes_from_the_package(
    path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.syspath_prepend(str(RUNS))
    import_module(path.stem)
