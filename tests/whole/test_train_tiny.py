"""Training end to end at toy sizes: the losses fall, runs chain, and what they made is exported."""

from dataclasses import replace

import pytest
import torch

from fake_rooms import FakeRooms
from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.data.batches import BatchConfig, SceneBatches
from instok3d.model.files import load_model, read_card
from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.tokenizer import TokenizerConfig
from instok3d.training.config import preset
from instok3d.training.export import export_model
from instok3d.training.loop import train
from instok3d.training.run_log import read_metrics
from instok3d.training.stages.geometry import GeometryStage, GeometryStageConfig
from instok3d.training.stages.tokenizer import TokenizerStage, TokenizerStageConfig

BACKBONE = NanoConfig(width=64, layers=1, match_channels=128)
TOKENIZER = TokenizerConfig(
    width=64,
    num_anchors=32,
    num_groups=6,
    anchor_layers=1,
    group_layers=1,
    gaussian_head=GaussianHeadConfig(gaussians_per_anchor=16),
)
ROOMS = FakeRooms(3, size=32)
QUICK = replace(
    preset("nano-geometry"), steps=3, holdout=1, batches=BatchConfig(batch_size=1), warmup_steps=1
)


def test_tokenizer_learns_one_sample_by_heart():
    """From the same true geometry again and again: render and grouping losses both fall."""
    torch.manual_seed(0)
    config = TokenizerStageConfig(
        backbone=BACKBONE, tokenizer=TOKENIZER, given_probability=1.0, seg_warmup_steps=0
    )
    stage = TokenizerStage(config)
    model = stage.build_model()
    sample = SceneBatches(ROOMS, [0], BatchConfig(1, photometric=False), seed=0).batch(0)
    optimizer = torch.optim.AdamW([p for p in model.parameters() if p.requires_grad], lr=2e-3)
    terms = []
    for step in range(25):
        loss = stage.loss(model, sample, step)
        optimizer.zero_grad()
        loss.total.backward()
        optimizer.step()
        terms.append({name: value.item() for name, value in loss.terms.items()})
    assert terms[-1]["mse_given"] < 0.5 * terms[0]["mse_given"]
    assert terms[-1]["seg_given"] < 0.5 * terms[0]["seg_given"]
    assert model.backbone.stem.stride8.weight.grad is None


@pytest.fixture(scope="module")
def geometry_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("geometry")
    config = replace(QUICK, stage=GeometryStageConfig(backbone=BACKBONE))
    train(config, GeometryStage(config.stage), ROOMS, folder)
    return folder


def test_geometry_run_reports_depth_and_camera_errors(geometry_run):
    last = read_metrics(geometry_run / "metrics.jsonl")[-1]
    assert last["kind"] == "validation"
    assert last.keys() >= {"depth_rel", "rotation_deg", "direction_deg"}
    with pytest.raises(ValueError, match="export a tokenizer run"):
        export_model(geometry_run, geometry_run / "model.safetensors")


def test_tokenizer_run_starts_from_the_backbone_and_is_exported(geometry_run, tmp_path):
    stage = TokenizerStageConfig(backbone=BACKBONE, tokenizer=TOKENIZER)
    config = replace(QUICK, stage=stage, validation_views=(2, 8))
    train(config, TokenizerStage(stage), ROOMS, tmp_path, init_from=geometry_run)
    last = read_metrics(tmp_path / "metrics.jsonl")[-1]
    assert last.keys() >= {"2views_predicted_psnr", "8views_given_ap50"}

    export_model(tmp_path, tmp_path / "model.safetensors")
    model = load_model(tmp_path / "model.safetensors")
    assert model.config == TOKENIZER
    assert read_card(tmp_path / "model.safetensors")["steps"] == 3
    # The backbone is still the one of the geometry run (up to float16).
    before = torch.load(next((geometry_run / "checkpoints").glob("*3.pt")), weights_only=True)[
        "average"
    ]
    torch.testing.assert_close(
        model.backbone.stem.stride8.weight, before["stem.stride8.weight"], rtol=1e-3, atol=1e-6
    )
