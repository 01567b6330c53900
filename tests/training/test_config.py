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
from instok3d.training.stages.tokenizer import TokenizerStageConfig


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


@pytest.mark.parametrize(
    ("name", "views", "updates", "warm_up"),
    [("scannet-2view", 2, 31_000, 3_000), ("scannet-8view", 8, 15_000, 1_500),
     ("re10k-2view", 2, 31_000, 3_000)],
)  # fmt: skip
def test_presets_of_the_tokenizer_hold_the_papers_numbers(name, views, updates, warm_up):
    run = preset(name)
    stage = run.stage
    assert isinstance(stage, TokenizerStageConfig)
    assert (run.steps, run.warmup_steps, run.batches.views) == (updates, warm_up, (views,))
    assert (run.lr, run.weight_decay) == (1e-4, 0.05)
    assert run.lr * run.final_lr_fraction == pytest.approx(1e-6)
    assert (run.clip_norm, run.amp, run.betas) == (0.5, True, (0.9, 0.95))
    assert (stage.seg_weight, stage.seg_warmup_steps, stage.lpips_weight) == (0.1, 1_500, 0.05)
    assert (stage.l1_weight, stage.gradient_weight) == (0.0, 0.0)
    assert stage.freeze_backbone
    assert (stage.given_probability, stage.intrinsics_probability) == (0.0, 1.0)
    assert stage.target_cameras == "true"
    sizes, head = stage.tokenizer, stage.tokenizer.gaussian_head
    assert (sizes.width, sizes.num_anchors, sizes.num_groups) == (1024, 1024, 100)
    assert (sizes.anchor_layers, sizes.group_layers) == (6, 4)
    assert (head.gaussians_per_anchor, head.sh_degree, head.seeding) == (32, 2, "anchor")
    assert (head.offset_bound, head.scale_max, sizes.normalize_scale) == (0.1, 0.3, False)
    assert (stage.backbone.img_size, stage.backbone.patch_size) == (256, 16)
    assert stage.backbone.intrinsics_token
    assert not run.batches.photometric


@pytest.mark.parametrize("name", [name for name in PRESETS if not name.startswith("nano")])
def test_four_processes_see_the_papers_32_samples_an_update(name):
    run = preset(name)
    samples = run.batches.batch_size * 2 // run.batches.views[0]
    assert samples * run.accumulate * 4 == 32


def test_in_the_adapt_runs_the_backbone_learns_ten_times_slower_and_is_not_decayed():
    for name in ("scannet-adapt", "re10k-adapt"):
        run = preset(name)
        assert (run.lr, run.backbone_lr_factor, run.backbone_weight_decay) == (1e-4, 0.1, 0.0)
        assert run.stage.lpips_weight == 0.05


def test_real_estate_runs_measure_in_baselines():
    assert preset("re10k-2view").batches.unit == preset("re10k-adapt").batches.unit == "baseline"
    assert preset("re10k-2view").masks == "sam2"
    assert preset("scannet-2view").batches.unit == preset("scannet-8view").batches.unit == "metre"
