import json

import pytest

from fake_rooms import FakeRooms
from instok3d.cli import main
from instok3d.training.checkpoint import read_checkpoint
from instok3d.training.config import read_config

SMALL = [
    "--stage.backbone.width", "64", "--stage.backbone.layers", "1", "--batches.batch-size", "1",
    "--batches.views", "2", "--holdout", "1", "--threads", "1",
]  # fmt: skip


@pytest.fixture(autouse=True)
def asked_seeds(monkeypatch) -> list[range]:
    asked = []

    def rooms(folder, seeds):
        asked.append(seeds)
        return FakeRooms(3, size=32)

    monkeypatch.setattr("instok3d.cli.train.RoomDataset", rooms)
    return asked


def test_validation_and_test_rooms_are_never_trained_on(tmp_path, asked_seeds):
    run = ["train", "nano-geometry", "--data", "rooms", "-o", str(tmp_path)]
    assert main([*run, "--steps", "1", *SMALL]) == 0
    assert asked_seeds == [range(1_000_000)]


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


def test_tokenizer_without_a_backbone_is_refused(tmp_path, capsys):
    assert main(["train", "nano-tokenizer", "--data", "rooms", "-o", str(tmp_path / "run")]) == 2
    assert "needs --init-from" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_unknown_setting_is_refused(tmp_path, capsys):
    run = ["train", "nano-geometry", "--data", "rooms", "-o", str(tmp_path)]
    assert main([*run, "--learning-rate", "1"]) == 2
    assert "learning-rate" in capsys.readouterr().err
