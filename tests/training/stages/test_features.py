from dataclasses import replace
from pathlib import Path

import pytest
import torch

from fake_rooms import FakeRooms
from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.baselines.feature_files import load_feature_model
from instok3d.baselines.pixel_features import PixelFeatureConfig
from instok3d.baselines.query_gaussians import QueryGaussianConfig
from instok3d.data.batches import BatchConfig, SceneBatches
from instok3d.data.sample import Sample, photos_only
from instok3d.data.words import ObjectWords
from instok3d.model.pixel_gaussians import PixelGaussianConfig
from instok3d.semantics.text import quantized, save_table
from instok3d.training.config import TrainConfig, from_json, preset, to_json
from instok3d.training.stages.answers import AveragedRun
from instok3d.training.stages.features import (
    FeatureStage,
    PixelFeaturesStageConfig,
    QueryGaussiansStageConfig,
)

NAMES = ("cabinet", "bed", "table", "red", "wood")
NANO = NanoConfig(width=64, layers=1)
STAGES = {
    "uni3r-style": PixelFeaturesStageConfig(
        backbone=NANO,
        model=PixelFeatureConfig(PixelGaussianConfig(8, 0, feature_channels=6), 16),
    ),
    "c3g-style": QueryGaussiansStageConfig(
        backbone=NANO, model=QueryGaussianConfig(40, 64, 1, encoder_channels=16)
    ),
}


@pytest.fixture(scope="module")
def teacher(tmp_path_factory: pytest.TempPathFactory) -> str:
    path: Path = tmp_path_factory.mktemp("table") / "table.safetensors"
    vectors = torch.randn(len(NAMES) + 1, 16, generator=torch.Generator().manual_seed(2))
    save_table(quantized(vectors, ("[UNK]", *NAMES), "made"), path)
    return f"words:{path}"


@pytest.fixture(scope="module")
def sample() -> Sample:
    batch = SceneBatches(FakeRooms(2, size=32), [0, 1], BatchConfig(2), seed=0).batch(0)
    words = {k: ObjectWords(NAMES[k - 1], "red", "wood") for k in (1, 2, 3)}
    return replace(batch, words=(words, words))


@pytest.mark.parametrize("name", STAGES)
def test_pictures_and_features_learn_and_the_backbone_stays(name, teacher, sample):
    stage = FeatureStage(replace(STAGES[name], teacher=teacher))
    torch.manual_seed(0)
    model = stage.build_model()
    before = {key: value.clone() for key, value in model.backbone.state_dict().items()}
    optimizer = torch.optim.Adam([p for p in model.parameters() if p.requires_grad], 5e-3)
    with torch.no_grad():
        first = stage.validate(model, [sample])
    for step in range(15):
        loss = stage.loss(model, sample, step)
        expected = loss.terms["mse"] + 0.2 * loss.terms["features"]
        torch.testing.assert_close(loss.total.detach(), expected)
        optimizer.zero_grad()
        loss.total.backward()
        optimizer.step()
    with torch.no_grad():
        last = stage.validate(model, [sample])
    assert last["cosine"] > first["cosine"] + 0.05
    assert last["psnr"] > first["psnr"]
    assert all(torch.equal(v, before[k]) for k, v in model.backbone.state_dict().items())
    assert stage.learns_whole
    assert all(p.grad is not None for p in model.parameters() if p.requires_grad)
    assert stage.pictures(model, sample).size[0] > 128


@pytest.mark.parametrize("name", STAGES)
def test_without_a_weight_of_features_no_teacher_is_asked(name, sample):
    stage = FeatureStage(replace(STAGES[name], feature_weight=0.0))
    loss = stage.loss(stage.build_model(), sample, 0)
    assert set(loss.terms) == {"mse"}
    with torch.no_grad():
        assert set(stage.validate(stage.build_model(), [sample])) == {"psnr"}


@pytest.mark.parametrize("name", STAGES)
def test_a_run_gives_a_model_and_the_next_run_starts_from_it(name, tmp_path, sample):
    config = replace(STAGES[name], feature_weight=0.0)
    stage = FeatureStage(config)
    model = stage.build_model()
    file = tmp_path / "model.safetensors"
    config.export(AveragedRun(tmp_path, model.state_dict(), {}), file, half=False)
    views = photos_only(sample.context)
    again = load_feature_model(file, name)
    assert torch.equal(again(views).gaussians.sh, model.eval()(views).gaussians.sh)
    other = stage.build_model()
    stage.load_initial(other, model.state_dict())
    assert torch.equal(other.expand.weight, model.expand.weight)
    stage.load_initial(other, {k: 2 * v for k, v in model.backbone.state_dict().items()})
    name_of_one = "backbone.norm.weight"
    assert torch.equal(other.state_dict()[name_of_one], 2 * model.state_dict()[name_of_one])


def test_a_teacher_of_another_space_is_refused(teacher):
    with pytest.raises(ValueError, match=r"16 channels, not 256: set --stage\.model"):
        FeatureStage(PixelFeaturesStageConfig(backbone=NANO, teacher=teacher))
    with pytest.raises(ValueError, match="names no teacher"):
        FeatureStage(PixelFeaturesStageConfig(backbone=NANO))


@pytest.mark.parametrize("name", STAGES)
def test_the_presets_take_the_shipped_backbone_and_come_back_from_json(name):
    config = preset(f"nano-{name}")
    assert from_json(TrainConfig, to_json(config)) == config
    assert config.stage.first_weights().published == "default"
    assert config.batches == preset("nano-uni3r-style").batches
    parts = config.stage.new_model().named_parameters()
    assert not any(p.requires_grad for part, p in parts if part.startswith("backbone."))
