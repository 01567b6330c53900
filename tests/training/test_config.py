import json
from dataclasses import replace

import pytest

from instok3d.training.config import PRESETS, TrainConfig, from_json, preset, to_json


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


def test_unknown_preset_is_named():
    with pytest.raises(KeyError, match="no preset 'nano'"):
        preset("nano")
