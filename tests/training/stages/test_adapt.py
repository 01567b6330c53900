from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from fake_rooms import FakeRooms
from flat_rooms import FlatRooms
from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.data.batches import BatchConfig, SceneBatches, make_sample
from instok3d.data.sample import Sample
from instok3d.data.view_sampling import FrameChoice
from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.pixel_gaussians import PixelGaussianConfig, PixelScene
from instok3d.model.tokenizer import TokenizerConfig
from instok3d.training.stages.adapt import AdaptStage, AdaptStageConfig, new_adapt_model
from instok3d.training.stages.geometry import GeometryStage, GeometryStageConfig
from instok3d.training.stages.tokenizer import TokenizerStage, TokenizerStageConfig
from instok3d.types import Views

NANO = NanoConfig(width=64, layers=1)
TINY = AdaptStageConfig(
    backbone=NANO,
    head=PixelGaussianConfig(width=8, sh_degree=0),
    trained=("to_coarse_depth", "to_half", "to_fine_depth"),
    lpips_weight=0.0,
)


@pytest.fixture(scope="module")
def sample() -> Sample:
    config = BatchConfig(2, num_targets=3, photometric=False)
    return SceneBatches(FakeRooms(2, size=32), [0, 1], config, seed=0).batch(0)


def new_model(config: AdaptStageConfig = TINY):
    torch.manual_seed(0)
    return AdaptStage(config).build_model()


def test_loss_is_the_squared_error_at_all_targets_and_the_same_again(sample):
    stage, model = AdaptStage(TINY), new_model()
    loss = stage.loss(model, sample, 3)
    assert torch.equal(loss.total, stage.loss(model, sample, 3).total)
    assert torch.equal(loss.total.detach(), loss.terms["mse"])
    assert sample.target.images.shape[1] == 3  # the new view and both contexts
    with torch.no_grad():
        worse = replace(sample.target, images=1 - sample.target.images)
        assert stage.loss(model, replace(sample, target=worse), 3).total > loss.total


def test_only_the_parts_that_were_named_learn(sample):
    model = new_model()
    AdaptStage(TINY).loss(model, sample, 0).total.backward()
    moved = {name for name, p in model.named_parameters() if p.grad is not None}
    assert {name.split(".")[1] for name in moved if name.startswith("backbone.")} == {
        "to_coarse_depth", "to_half", "to_fine_depth",
    }  # fmt: skip
    head = list(model.head.parameters())
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in head)
    everything = new_model(replace(TINY, trained=()))
    assert all(p.requires_grad for p in everything.parameters())


def test_a_part_that_is_not_there_is_named():
    with pytest.raises(ValueError, match="names 'point_head', which NanoBackbone does not have"):
        new_adapt_model(replace(TINY, trained=("point_head",)))


def test_rendering_at_true_cameras_pulls_pointmaps_into_their_unit():
    # Contexts 1.2 m apart, 12 pixels of disparity on the wall: a wrong unit shows.
    wide = make_sample(FlatRooms([0], ["easy"]), 0, FrameChoice((0, 15), (7,)))
    model, stage = new_model(), AdaptStage(TINY)
    scene: PixelScene = model(wide.context)  # true cameras and depths: pointmaps in metres
    losses, gradients = {}, {}
    for metres in (0.5, 0.67, 1.0, 1.5, 2.0):
        unit = torch.tensor(metres, requires_grad=True)
        pointmaps = scene.geometry.pointmaps.detach() / unit
        geometry = replace(
            scene.geometry, pointmaps=pointmaps, features=scene.geometry.features.detach()
        )
        found = PixelScene(model.head(wide.context, geometry), geometry)
        loss = stage.loss(Answers(found), wide, 0).total
        loss.backward()
        losses[metres], gradients[metres] = loss.item(), unit.grad.item()
    assert 2 * losses[1.0] < min(losses[0.5], losses[2.0])
    assert gradients[0.67] < 0 < gradients[1.5]


class Answers(nn.Module):
    """A model that always says the same."""

    def __init__(self, scene: PixelScene) -> None:
        super().__init__()
        self.scene = scene

    def forward(self, views: Views) -> PixelScene:
        return self.scene


def test_validation_tells_the_unit_of_the_pointmaps(sample):
    model, stage = new_model(), AdaptStage(TINY)
    with torch.no_grad():
        once = stage.validate(model, [sample])
        model.backbone.to_coarse_depth.bias += np.log(2)
        twice = stage.validate(model, [sample])
    assert once.keys() == {"psnr", "unit", "depth_rel"}
    assert twice["unit"] / once["unit"] == pytest.approx(2, rel=0.05)
    assert twice["depth_rel"] == pytest.approx(once["depth_rel"], rel=0.05)
    unknown = replace(sample.context, depths=torch.zeros_like(sample.context.depths))
    with torch.no_grad():
        assert stage.validate(model, [replace(sample, context=unknown)]).keys() == {"psnr"}
        assert stage.pictures(model, sample).size[0] > 0


def test_without_lpips_weights_the_stage_does_not_begin(tmp_path, monkeypatch):
    monkeypatch.setenv("INSTOK3D_HOME", str(tmp_path))
    with pytest.raises(FileNotFoundError, match="lpips-vgg16 are not on this machine"):
        AdaptStage(replace(TINY, lpips_weight=0.05))


def test_the_head_is_thrown_away_and_the_backbone_goes_on():
    adapted = new_model()
    weights = adapted.state_dict()
    tokenizer = TokenizerStage(
        TokenizerStageConfig(
            backbone=NANO,
            tokenizer=TokenizerConfig(
                width=64, num_anchors=8, num_groups=4, anchor_layers=1, group_layers=1,
                gaussian_head=GaussianHeadConfig(gaussians_per_anchor=4),
            ),
        )
    )  # fmt: skip
    model = tokenizer.build_model()
    tokenizer.load_initial(model, weights)
    again = new_adapt_model(TINY)
    AdaptStage(TINY).load_initial(again, model.state_dict())
    for name, value in adapted.backbone.state_dict().items():
        assert torch.equal(model.backbone.state_dict()[name], value)
        assert torch.equal(again.backbone.state_dict()[name], value)
    AdaptStage(TINY).load_initial(again, weights)
    assert all(torch.equal(again.state_dict()[name], value) for name, value in weights.items())


def test_a_geometry_run_starts_an_adapt_run():
    geometry = GeometryStage(GeometryStageConfig(backbone=NANO)).build_model()
    model = new_model()
    AdaptStage(TINY).load_initial(model, geometry.state_dict())
    name = "stem.stride8.weight"
    assert torch.equal(model.backbone.state_dict()[name], geometry.state_dict()[name])
