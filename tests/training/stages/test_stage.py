"""A stage that only the tests know goes the whole way, from plan to exported file."""

import json
from dataclasses import replace

import pytest
import torch
from safetensors.torch import load_file

from fake_rooms import FakeRooms
from instok3d.cli import main, train
from instok3d.training.checkpoint import read_checkpoint
from instok3d.training.config import PRESETS, TrainConfig, from_json, preset, to_json
from instok3d.training.cost.estimate import flop_per_sample, model_on_paper, training_memory_bytes
from instok3d.training.cost.scene_check import check_scenes
from instok3d.training.stages.answers import AveragedRun
from instok3d.training.stages.stage import Stage, StageConfig
from toy_stage import TINY, ToyStageConfig

RUN = ["train", "toy", "--data", "rooms", "--stage.width", "4", "--threads", "1"]


@pytest.fixture(autouse=True)
def toy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PRESETS, "toy", TINY)
    monkeypatch.setitem(train.COMMANDS, "toy", "the smallest stage")
    for module in ("train_runs", "train_cache"):
        monkeypatch.setattr(
            f"instok3d.cli.{module}.open_training_scenes",
            lambda folder, masks=None: FakeRooms(3, size=16),
        )


def test_it_is_planned(capsys: pytest.CaptureFixture[str]):
    assert main([*RUN, "--dry-run"]) == 0
    lines = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert lines["stage"] == "toy"
    assert lines["missing"] == "nothing"


def test_it_is_trained_resumed_bit_for_bit_and_exported(tmp_path, capsys):
    straight, parts = tmp_path / "straight", tmp_path / "parts"
    assert main([*RUN, "-o", str(straight), "--steps", "5"]) == 0
    assert main([*RUN, "-o", str(parts), "--steps", "2", "--cosine-steps", "5"]) == 0
    capsys.readouterr()
    assert main([*RUN[:4], "-o", str(parts), "--resume", "--steps", "5"]) == 0
    assert json.loads(capsys.readouterr().out) == {"step": 5, "ended": "finished"}
    one, other = read_checkpoint(straight), read_checkpoint(parts)
    for part in ("model", "average"):
        assert one[part].keys() == other[part].keys()
        assert all(torch.equal(value, other[part][n]) for n, value in one[part].items())
    assert other["model"]["0.weight"].shape == (4, 3)  # the width of the command line

    file = tmp_path / "toy.safetensors"
    assert main(["train", "export", str(parts), "-o", str(file), "--float32"]) == 0
    assert json.loads(capsys.readouterr().out)["steps"] == 5
    exported = load_file(file)
    assert all(torch.equal(exported[n], value) for n, value in other["average"].items())


def test_its_cost_is_that_of_every_parameter_at_every_pixel():
    model = model_on_paper(TINY)
    assert sum(p.numel() for p in model.parameters()) == 3 * 8 + 8 + 8 + 1 + 1
    assert flop_per_sample(TINY, model, 2, 16, 16) == 2 * 42 * 3 * 2 * 16 * 16
    # A pixel keeps input and output of the two layers, 3 + 8 and 8 + 1, as float32.
    one = replace(TINY, batches=replace(TINY.batches, batch_size=1, views=(2,)))
    small, large = (training_memory_bytes(one, model, side, 16) for side in (16, 32))
    assert large - small == 2 * 16 * 16 * (11 + 9) * 4


def test_scenes_without_what_it_learns_from_are_refused():
    class Flat(FakeRooms):
        def frames(self, number, chosen):
            frames = super().frames(number, chosen)
            return replace(frames, depths_m=0 * frames.depths_m)

    assert check_scenes(TINY, FakeRooms(3, size=16)) == (16, 16)
    with pytest.raises(ValueError, match="has no true depth"):
        check_scenes(TINY, Flat(3, size=16))


def test_features_of_a_stage_without_a_frozen_backbone_are_not_cached(tmp_path, capsys):
    words = ["train", "cache", "--preset", "toy", "--data", "rooms", "-o", str(tmp_path / "cache")]
    assert main([*words, "--init-from", str(tmp_path)]) == 2
    assert "toy run is not frozen" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "cache").exists()


def test_settings_of_every_stage_come_back_from_json():
    for config in PRESETS.values():
        assert from_json(TrainConfig, json.loads(json.dumps(to_json(config)))) == config


def test_settings_of_an_unknown_stage_are_named():
    content = to_json(TINY)
    content["stage"]["type"] = "DanceStageConfig"
    with pytest.raises(
        ValueError, match=r"stage must be of one of .*'ToyStageConfig'.*, got 'Dance"
    ):
        from_json(TrainConfig, content)


@pytest.mark.parametrize("name", list(PRESETS))
def test_every_stage_has_a_name_and_a_model_that_learns(name: str):
    config = preset(name).stage
    assert isinstance(config, StageConfig)
    assert type(config).__name__.lower() == f"{config.name}stageconfig"
    assert any(p.requires_grad for p in model_on_paper(preset(name)).parameters())


def test_the_stage_is_made_of_its_settings():
    assert isinstance(ToyStageConfig().build(), Stage)


def test_a_stage_with_nothing_to_export_says_what_to_do(tmp_path):
    with pytest.raises(ValueError, match=r"is a geometry run.*--init-from.*export a tokenizer run"):
        preset("nano-geometry").stage.export(
            AveragedRun(tmp_path, {}, {}), tmp_path / "x", half=True
        )
