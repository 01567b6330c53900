"""The whole chain on a GPU against the CPU, at toy size."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from fake_rooms import FakeRooms
from instok3d import reconstruct
from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.tokenizer import TokenizerConfig
from instok3d.training.checkpoint import read_checkpoint
from instok3d.training.loop import train
from instok3d.training.run_log import read_metrics
from instok3d.training.stages.tokenizer import TokenizerStageConfig
from made_model import made_model, made_photos
from tiny_vggt import tiny_vggt
from toy_stage import TINY


@pytest.mark.gpu
def test_photos_become_a_scene_on_the_cpu_like_that_made_there(tmp_path: Path):
    photos, model = made_photos(tmp_path / "photos"), made_model(tmp_path / "model.safetensors")
    here, there = (reconstruct(photos, model=model, device=each) for each in ("cpu", "cuda"))
    assert there.gaussians.means.device.type == "cpu"
    assert there.gaussians.means.shape == here.gaussians.means.shape
    assert there.render().colors.isfinite().all()


@pytest.mark.gpu
def test_vggt_answers_on_a_gpu_as_on_the_cpu():
    network, images = tiny_vggt(), torch.rand(1, 2, 3, 64, 64)
    layers = {network.config.depth - 1}
    with torch.no_grad():
        here = network.aggregator(images, None, layers=layers)
        there = network.cuda().aggregator(images.cuda(), None, layers=layers)
    for layer, tokens in here.items():
        assert (there[layer].cpu() - tokens).norm() <= 1e-3 * tokens.norm()


@pytest.mark.gpu
def test_the_tokenizer_trains_on_a_gpu_in_bfloat16(tmp_path: Path):
    stage = TokenizerStageConfig(
        backbone=NanoConfig(width=64, layers=1),
        tokenizer=TokenizerConfig(
            width=64, num_anchors=8, num_groups=4, anchor_layers=1, group_layers=1,
            gaussian_head=GaussianHeadConfig(gaussians_per_anchor=4),
        ),
    )  # fmt: skip
    config = replace(TINY, stage=stage, device="cuda", amp=True, steps=3, holdout=1)
    outcome = train(config, stage.build(), FakeRooms(4, size=32), tmp_path)
    assert outcome.reason == "finished"
    assert read_checkpoint(tmp_path)["step"] == 3
    assert all(line["loss"] > 0 for line in read_metrics(tmp_path / "metrics.jsonl")
               if line["kind"] == "train")  # fmt: skip
