import json

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file

from fake_rooms import FakeRooms
from instok3d.cli import main
from instok3d.datasets.opening import open_training_scenes
from instok3d.training.checkpoint import read_checkpoint
from instok3d.training.config import read_config

SMALL = [
    "--stage.backbone.width", "64", "--stage.backbone.layers", "1", "--batches.batch-size", "1",
    "--batches.views", "2", "--holdout", "1", "--threads", "1",
]  # fmt: skip


@pytest.fixture(autouse=True)
def rooms(monkeypatch):
    monkeypatch.setattr(
        "instok3d.cli.train_runs.open_training_scenes",
        lambda folder, masks=None: FakeRooms(3, size=32),
    )


def test_geometry_run_and_its_continuation(tmp_path, capsys):
    run = ["train", "nano-geometry", "--data", "rooms", "-o", str(tmp_path)]
    assert main([*run, "--steps", "1", "--lr", "0.001", *SMALL]) == 0
    assert json.loads(capsys.readouterr().out) == {"step": 1, "ended": "finished"}
    # The settings of the run stand unless given again.
    assert main([*run, "--resume", "--steps", "2"]) == 0
    assert read_checkpoint(tmp_path)["step"] == 2
    assert (read_config(tmp_path).lr, read_config(tmp_path).steps) == (0.001, 2)

    assert main([*run, "--resume", "--stage.backbone.width", "128"]) == 2
    assert "sizes cannot be changed on resuming" in capsys.readouterr().err

    assert main([*run, "--steps", "1", *SMALL]) == 2
    assert "pass --resume" in capsys.readouterr().err
    assert main(["train", "nano-tokenizer", *run[2:], "--resume"]) == 2
    assert "a run of another stage than nano-tokenizer" in capsys.readouterr().err
    assert main(["train", "export", str(tmp_path), "-o", str(tmp_path / "x.safetensors")]) == 2
    assert "export a tokenizer run" in capsys.readouterr().err


def test_the_masks_of_a_run_are_those_of_its_continuation(tmp_path, monkeypatch):
    asked = []

    def opened(folder, masks=None):
        asked.append(masks)
        return FakeRooms(3, size=32)

    monkeypatch.setattr("instok3d.cli.train_runs.open_training_scenes", opened)
    run = ["train", "nano-geometry", "--data", "rooms", "-o", str(tmp_path)]
    assert main([*run, "--steps", "0", "--masks", "sam2", *SMALL]) == 0
    assert read_config(tmp_path).masks == "sam2"
    assert main([*run, "--resume", "--steps", "0"]) == 0
    assert asked == ["sam2", "sam2"]


def test_tokenizer_without_a_backbone_is_refused(tmp_path, capsys):
    assert main(["train", "nano-tokenizer", "--data", "rooms", "-o", str(tmp_path / "run")]) == 2
    assert "needs --init-from" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_unknown_setting_is_refused(tmp_path, capsys):
    run = ["train", "nano-geometry", "--data", "rooms", "-o", str(tmp_path)]
    assert main([*run, "--learning-rate", "1"]) == 2
    assert "learning-rate" in capsys.readouterr().err


def test_a_dry_run_prints_the_plan_and_writes_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("INSTOK3D_HOME", str(tmp_path / "home"))
    assert main(["train", "nano-tokenizer", "--data", "rooms", "--dry-run", "--holdout", "1"]) == 0
    lines = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert lines["stage"] == "tokenizer"
    assert lines["scenes"] == "2 to train on with 32 frames, 1 held out"
    assert lines["steps"].startswith("20000 updates, ")
    assert lines["frozen"].endswith("M parameters: backbone 8.91 M")
    assert "give the run that made it with --init-from" in lines["missing"]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("data", [[], ["--data", "nowhere"]])
def test_a_dry_run_needs_no_scenes_and_a_run_does(data, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("instok3d.cli.train_runs.open_training_scenes", open_training_scenes)
    assert main(["train", "scannet-adapt", *data, "--dry-run"]) == 0
    shown = capsys.readouterr()
    lines = dict(line.split(maxsplit=1) for line in shown.out.splitlines())
    assert lines["scenes"].startswith("none yet; needed are scenes of ScanNet")
    assert lines["missing"].startswith("scenes to train on: make them by `instok3d data prepare")
    assert lines["time"].startswith("about ")
    assert ("nowhere holds neither rooms" in shown.err) == bool(data)
    assert main(["train", "scannet-adapt", *data, "-o", "run"]) == 2
    assert ("nowhere" if data else "give --data DIR") in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_run_without_a_folder_is_refused(tmp_path, capsys):
    assert main(["train", "nano-geometry", "--data", "rooms", *SMALL]) == 2
    assert "give -o RUN, or --dry-run" in capsys.readouterr().err


def test_an_adapt_run_starts_a_tokenizer_run_and_exports_its_backbone(tmp_path, capsys):
    tiny = [*SMALL, "--steps", "1", "--stage.head.width", "8", "--stage.weights", "None"]
    run = ["train", "nano-adapt", "--data", "rooms", "-o", str(tmp_path / "adapt"), *tiny]
    assert main(run) == 2
    assert "an adapt run needs --init-from RUN" in capsys.readouterr().err
    geometry = ["train", "nano-geometry", "--data", "rooms", "-o", str(tmp_path / "geometry")]
    assert main([*geometry, *SMALL, "--steps", "1"]) == 0
    assert main([*run, "--init-from", str(tmp_path / "geometry")]) == 0
    file = tmp_path / "backbone.safetensors"
    assert main(["train", "export", str(tmp_path / "adapt"), "-o", str(file), "--float32"]) == 0
    kept = {**(found := read_checkpoint(tmp_path / "adapt"))["model"], **found["average"]}
    exported = load_file(file)
    assert exported.keys() == {
        name.removeprefix("backbone.") for name in kept if name.startswith("backbone.")
    }
    assert all(torch.equal(exported[name], kept[f"backbone.{name}"]) for name in exported)
    with safe_open(file, framework="pt") as stream:
        card = json.loads(stream.metadata()["card"])
    assert card["image_side"] == 32  # of the rooms
    assert card["unit"] == "metre"  # rendered at true cameras
    tokenizer = ["train", "nano-tokenizer", "--data", "rooms", "-o", str(tmp_path / "tokenizer")]
    tiny = ["--steps", "1", "--stage.tokenizer.width", "64", "--stage.tokenizer.num-anchors", "8"]
    assert main([*tokenizer, *SMALL, *tiny, "--init-from", str(file)]) == 0


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--gpus", "0", "--dry-run"], "processes must be at least 1, got 0"),
        (["--steps", "-3", "--dry-run"], "steps must be at least 0, got -3"),
        (["--accumulate", "0", "--dry-run"], "accumulate must be at least 1, got 0"),
        (["--clip-norm", "0", "--dry-run"], "clip_norm must be above 0"),
        (["--device", "xpu9", "--dry-run"], "device must be cpu, cuda or cuda:N, got 'xpu9'"),
        (["--validation-views", "--dry-run"], "validation_views must hold 2 or 8, got none"),
    ],
)
def test_counts_that_count_nothing_are_refused(words, told, capsys):
    assert main(["train", "nano-geometry", "--data", "rooms", "--holdout", "1", *words]) == 2
    assert told in " ".join(capsys.readouterr().err.split())


def test_a_device_that_is_not_there_is_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    run = ["train", "nano-geometry", "--data", "rooms", "-o", str(tmp_path / "run")]
    assert main([*run, "--holdout", "1", "--device", "cuda"]) == 2
    assert "torch sees no CUDA device" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
