"""Damaged checkpoints, settings and records of a run are read, or refused in one line."""

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.training.checkpoint import (
    RunState,
    WeightAverage,
    read_checkpoint,
    read_weights,
    restore,
    restore_weights,
    save_checkpoint,
)
from instok3d.training.config import preset, read_config, to_json, write_config
from instok3d.training.export import export_model
from instok3d.training.run_log import read_metrics
from instok3d.training.stages.tokenizer import TokenizerStageConfig
from mutations import of_bytes, of_json, of_safetensors, of_zip, survive


def made_state() -> RunState:
    torch.manual_seed(0)
    model = nn.Linear(4, 3)
    optimizer = torch.optim.AdamW(model.parameters())
    model(torch.ones(1, 4)).sum().backward()
    optimizer.step()
    return RunState(model, optimizer, WeightAverage(model, 0.9), scene_names=["3", "1"])


def resume(folder: Path) -> RunState:
    state, checkpoint = made_state(), read_checkpoint(folder)
    restore_weights(state.model, checkpoint)
    restore(state, checkpoint)
    return state


def test_a_checkpoint(tmp_path: Path):
    file = save_checkpoint(tmp_path, made_state(), {})

    def read() -> None:
        assert resume(tmp_path).step >= 0
        read_weights(tmp_path)

    assert survive(file, read, of_zip, 120)
    resume(tmp_path)


CHANGES: dict[str, Callable[[dict[str, Any]], object]] = {
    "-1 is no whole number": lambda c: c.update(step=-1),
    "'3' is no whole number": lambda c: c.update(skipped="3"),
    "elapsed_s is nan": lambda c: c.update(elapsed_s=float("nan")),
    "it lacks 'optimizer'": lambda c: c.pop("optimizer"),
    "weight in model is no tensor of finite": lambda c: c["model"]["weight"].fill_(torch.nan),
    "bias in average is no tensor of finite": lambda c: c["average"]["bias"].fill_(torch.inf),
    "exp_avg of the optimizer is not a number": lambda c: c["optimizer"]["state"][0][
        "exp_avg"
    ].fill_(torch.nan),
    "5 is no text": lambda c: c.update(scene_names=[5]),
    "config is damaged": lambda c: c.update(config="{"),
    "0 is no whole number": lambda c: c.update(image_size=(0, 3)),
    "the average of bias has the shape": lambda c: c["average"].update(bias=torch.ones(1)),
    r"do not fit the model .* size mismatch": lambda c: c["model"].update(bias=torch.ones(1)),
    "is damaged .*param": lambda c: c["optimizer"].update(param_groups=[{}]),
    "is damaged .*torch": lambda c: c["random"][0].pop("torch"),
}


@pytest.mark.filterwarnings("ignore:.*trying the one before")
@pytest.mark.parametrize("reason", CHANGES)
def test_a_checkpoint_that_cannot_be_is_refused_with_the_reason(tmp_path: Path, reason: str):
    file = save_checkpoint(tmp_path, made_state(), {})
    content = torch.load(io.BytesIO(file.read_bytes()), weights_only=True)
    CHANGES[reason](content)
    torch.save(content, file)
    with pytest.raises(ValueError, match=rf"step_00000000\.pt.*{reason}") as refusal:
        resume(tmp_path)
    assert "\n" not in str(refusal.value)


def test_first_weights(tmp_path: Path):
    file = tmp_path / "first.safetensors"
    save_file({"w": torch.ones(3), "b": torch.zeros(1)}, file, {"format": "x"})

    def read() -> None:
        assert all(value.isfinite().all() for value in read_weights(file).values())

    assert survive(file, read, of_safetensors, 100)
    save_file({"w": torch.tensor([1, torch.nan])}, file)
    with pytest.raises(ValueError, match=r"first\.safetensors has the weight w, which is not fin"):
        read_weights(file)


def test_settings(tmp_path: Path):
    write_config(tmp_path, preset("nano-tokenizer"), commit="")
    assert survive(tmp_path / "config.json", lambda: read_config(tmp_path), of_json, 100)
    for other in ("[]", "{}", '{"config": null}', '{"config": 3}', ""):
        (tmp_path / "config.json").write_text(other)
        with pytest.raises(ValueError, match=r"config\.json is damaged"):
            read_config(tmp_path)


def test_metrics(tmp_path: Path):
    file = tmp_path / "metrics.jsonl"
    lines = [{"kind": "train", "step": step, "elapsed_s": 0.5, "loss": 1.0} for step in range(4)]
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert survive(file, lambda: read_metrics(file), of_bytes, 100)
    file.write_text('{"kind": "train"}\n' + json.dumps(lines[0]) + "\n")
    with pytest.raises(ValueError, match=r"metrics\.jsonl, line 1, is damaged \(it lacks 'step'"):
        read_metrics(file)
    file.write_text("")
    assert read_metrics(file) == []


EXPORTED: dict[str, Callable[[dict[str, Any]], object]] = {
    "config has no setting .'speed'": lambda c: c.update(config='{"speed": 3}'),
    "config.steps must be": lambda c: c.update(config='{"steps": "x"}'),
    "config.stage must be of one of the types": lambda c: c.update(config='{"stage": {}}'),
    "do not fit the model that its settings ask for": lambda c: None,
    "it lacks 'commit'": lambda c: c.pop("commit"),
    "3 is no text": lambda c: c.update(commit=3),
}


@pytest.mark.filterwarnings("ignore:.*trying the one before")
@pytest.mark.parametrize("reason", EXPORTED)
def test_a_checkpoint_that_cannot_be_is_not_exported(tmp_path: Path, reason: str):
    sizes = NanoConfig(width=8, layers=1)
    config = replace(preset("nano-tokenizer"), stage=TokenizerStageConfig(backbone=sizes))
    file = save_checkpoint(tmp_path, made_state(), to_json(config))
    content = torch.load(io.BytesIO(file.read_bytes()), weights_only=True)
    EXPORTED[reason](content)
    torch.save(content, file)
    (tmp_path / "metrics.jsonl").write_text("")
    with pytest.raises(ValueError, match=rf"step_00000000\.pt.*{reason}") as refusal:
        export_model(tmp_path, tmp_path / "model.safetensors")
    assert "\n" not in str(refusal.value)
    assert not (tmp_path / "model.safetensors").exists()
