import json
from dataclasses import replace

import pytest

from instok3d.training.config import (
    PRESETS,
    TrainConfig,
    from_json,
    overlay,
    preset,
    read_config,
    to_json,
    write_config,
)


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_presets_survive_json(name):
    text = json.dumps(to_json(replace(preset(name), cosine_steps=7, threads=None)))
    read = from_json(TrainConfig, json.loads(text))
    assert read == replace(preset(name), cosine_steps=7)


def test_unknown_key_is_named():
    written = to_json(preset("nano-geometry"))
    with pytest.raises(KeyError, match=r"config has no setting \['learning_rate'\]"):
        from_json(TrainConfig, {**written, "learning_rate": 1.0})
    written["batches"]["batch"] = 3
    with pytest.raises(KeyError, match=r"config\.batches has no setting \['batch'\]"):
        from_json(TrainConfig, written)


@pytest.mark.parametrize(
    ("key", "value"),
    [("lr", "fast"), ("steps", 1.5), ("amp", 1), ("betas", [0.9]), ("cosine_steps", "no"),
     ("stage", {"type": "Nothing"})],
)  # fmt: skip
def test_value_of_another_type_is_refused(key, value):
    with pytest.raises(ValueError, match=rf"config\.{key} must be"):
        from_json(TrainConfig, {**to_json(preset("nano-tokenizer")), key: value})


def test_settings_given_on_resuming_change_those_of_the_run_and_no_others():
    run = replace(preset("nano-tokenizer"), steps=5, lr=1e-3)
    wanted = replace(preset("nano-tokenizer"), steps=9)
    wanted = replace(wanted, stage=replace(wanted.stage, seg_weight=0.3))
    found = overlay(run, preset("nano-tokenizer"), wanted)
    assert (found.steps, found.lr, found.stage.seg_weight) == (9, 1e-3, 0.3)
    assert overlay(run, wanted, wanted) == run


def test_settings_of_a_run_are_read_back(tmp_path):
    run = preset("nano-tokenizer")
    run = replace(run, stage=replace(run.stage, lpips_file=tmp_path / "lpips.safetensors"))
    write_config(tmp_path, run, commit="unknown")
    assert read_config(tmp_path) == run
    with pytest.raises(FileNotFoundError, match=r"no config\.json"):
        read_config(tmp_path / "elsewhere")


def test_unknown_preset_is_named():
    with pytest.raises(KeyError, match="no preset 'nano'"):
        preset("nano")
