from dataclasses import replace

import numpy as np
import pytest
import torch

from fake_rooms import FakeRooms
from instok3d.backbones.nano.backbone import NanoBackbone, NanoConfig
from instok3d.baselines.segmenter import Segmenter, SegmenterConfig
from instok3d.baselines.segmenter_file import load_segmenter
from instok3d.data.batches import BatchConfig, SceneBatches
from instok3d.data.sample import Sample
from instok3d.semantics.predictor import PredictorConfig
from instok3d.training.config import preset
from instok3d.training.stages.answers import AveragedRun
from instok3d.training.stages.segmenter import (
    SegmenterStage,
    SegmenterStageConfig,
    single_photos,
)

SIZES = PredictorConfig(64, 64, 2, 64, quarter_channels=32, half_channels=32)
TINY = SegmenterStageConfig(SegmenterConfig(SIZES, num_queries=8, decoder_layers=1))


@pytest.fixture(scope="module")
def sample() -> Sample:
    return SceneBatches(FakeRooms(2, size=32), [0, 1], BatchConfig(2), seed=0).batch(0)


@pytest.fixture
def model() -> Segmenter:
    torch.manual_seed(0)
    return SegmenterStage(TINY).build_model()


def test_every_photo_is_a_sample_of_its_own(sample):
    photos, ids = single_photos(sample)
    contexts = sample.context.images.shape[1]
    assert len(photos) == len(ids) == 2 * (contexts + sample.target.images.shape[1])
    assert torch.equal(photos[contexts], sample.context.images[1, 0])
    assert torch.equal(ids[-1], sample.target_instances[1, -1])


def test_it_learns_the_masks_of_a_batch(sample, model):
    stage = SegmenterStage(TINY)
    before = stage.validate(model, [sample])
    optimizer = torch.optim.Adam(model.parameters(), 3e-3)
    losses = []
    for step in range(45):
        loss = stage.loss(model, sample, step)
        torch.testing.assert_close(loss.terms["bce"] + loss.terms["dice"], loss.total.detach())
        optimizer.zero_grad()
        loss.total.backward()
        optimizer.step()
        losses.append(float(loss.total.detach()))
    assert losses[-1] < 0.7 * losses[0]
    after = stage.validate(model, [sample])
    assert after["ap50"] > before["ap50"] + 0.1
    assert stage.pictures(model, sample).size[0] > 96


def test_ids_across_views_play_no_part(sample, model):
    stage = SegmenterStage(TINY)
    other = replace(sample, target_instances=sample.target_instances * 7)
    torch.testing.assert_close(
        stage.loss(model, sample, 0).total, stage.loss(model, other, 0).total
    )


def test_a_batch_without_instances_gives_a_loss_of_zero(sample, model):
    empty = replace(
        sample,
        context_instances=torch.zeros_like(sample.context_instances),
        target_instances=torch.zeros_like(sample.target_instances),
    )
    stage = SegmenterStage(TINY)
    loss = stage.loss(model, empty, 0).total
    loss.backward()
    assert float(loss.detach()) == 0
    assert np.isnan(stage.validate(model, [empty])["ap"])


def test_it_starts_from_the_encoder_of_a_nano_backbone(model):
    backbone = NanoBackbone(NanoConfig(width=64, layers=1))
    weights = backbone.state_dict()
    for found in (weights, {f"backbone.{name}": value for name, value in weights.items()}):
        SegmenterStage(TINY).load_initial(model, found)
        for k, kind in enumerate(("frame", "global")):
            own = model.state_dict()[f"predictor.blocks.{k}.expand.weight"]
            assert torch.equal(own, weights[f"{kind}_blocks.0.expand.weight"])
        model.predictor.stem.stride8.weight.data.zero_()
    other = SegmenterStage(TINY).build_model()
    SegmenterStage(TINY).load_initial(model, other.state_dict())
    assert torch.equal(model.queries, other.queries)


def test_the_file_of_a_run_is_a_segmenter(tmp_path, model):
    run = AveragedRun(tmp_path, model.state_dict(), {"steps": 3})
    TINY.export(run, tmp_path / "segmenter.safetensors", half=False)
    photos = torch.rand(1, 3, 32, 32)
    again = load_segmenter(tmp_path / "segmenter.safetensors")
    assert torch.equal(again(photos), model.eval()(photos))


def test_the_preset_starts_with_the_shipped_model_and_needs_ids():
    stage = preset("nano-segmenter").stage
    assert stage.first_weights().published == "default"
    assert stage.data_needs().instances
    assert stage.workload().cell_side == 2
    assert stage.name == "segmenter"
    assert sum(p.numel() for p in stage.new_model().parameters()) < 9e6
