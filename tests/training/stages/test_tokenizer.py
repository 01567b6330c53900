from dataclasses import replace

import numpy as np
import pytest
import torch

from fake_rooms import FakeRooms
from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.data.batches import BatchConfig, SceneBatches
from instok3d.data.sample import Sample, photos_only
from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.tokenizer import TokenizerConfig
from instok3d.objectives.assignment import assignment_loss
from instok3d.training.stages.target_cameras import cameras_of_targets
from instok3d.training.stages.tokenizer import (
    TokenizerStage,
    TokenizerStageConfig,
    gradient_error,
    groups_used,
)

TINY = TokenizerStageConfig(
    backbone=NanoConfig(width=64, layers=1),
    tokenizer=TokenizerConfig(
        width=64,
        num_anchors=8,
        num_groups=4,
        anchor_layers=1,
        group_layers=1,
        gaussian_head=GaussianHeadConfig(gaussians_per_anchor=4),
    ),
    seg_warmup_steps=0,
)


@pytest.fixture(scope="module")
def sample() -> Sample:
    return SceneBatches(FakeRooms(2, size=32), [0, 1], BatchConfig(2), seed=0).batch(0)


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(0)
    return TokenizerStage(TINY).build_model()


def test_loss_of_a_step_is_the_same_again_and_mixes_both_geometries(model, sample):
    stage = TokenizerStage(TINY)
    modes = []
    for step in range(12):
        loss = stage.loss(model, sample, step)
        modes.append("mse_given" in loss.terms)
        if step < 2:
            assert torch.equal(loss.total, stage.loss(model, sample, step).total)
    assert 2 <= sum(modes) <= 10


def test_share_of_given_geometry_is_what_was_asked_for(model, sample):
    always = TokenizerStage(replace(TINY, given_probability=1.0))
    never = TokenizerStage(replace(TINY, given_probability=0.0))
    for step in range(3):
        assert "mse_given" in always.loss(model, sample, step).terms
        assert "mse_predicted" in never.loss(model, sample, step).terms


def test_total_is_the_weighted_sum_of_its_parts(model, sample):
    stage = TokenizerStage(replace(TINY, given_probability=1.0, seg_weight=0.25))
    loss = stage.loss(model, sample, 5)
    expected = loss.terms["mse_given"] + 0.25 * (loss.terms["bce"] + loss.terms["dice"])
    torch.testing.assert_close(loss.total.detach(), expected)


def test_anchors_answer_for_their_own_patches_where_it_is_asked(model, sample):
    stage = TokenizerStage(replace(TINY, given_probability=1.0, assignment_weight=0.5))
    loss = stage.loss(model, sample, 5)
    parts = loss.terms["mse_given"] + 0.1 * loss.terms["seg_given"] + 0.5 * loss.terms["assigned"]
    torch.testing.assert_close(loss.total.detach(), parts)
    assert "assigned" not in TokenizerStage(TINY).loss(model, sample, 5).terms
    # Told by hand: the patches of 8 x 8 pixels that the anchors were taken from.
    groups = model(sample.context)
    expected = 0.0
    starts = range(0, 32, 8)
    for scene in range(2):
        patches = [
            sample.context_instances[scene, view, top : top + 8, left : left + 8].flatten()
            for view in range(2)
            for top in starts
            for left in starts
        ]
        ids = torch.stack([patches[k] for k in groups.anchors.patches[scene]])
        expected += assignment_loss(groups.assignment[scene][None], ids[None]).total.item() / 2
    assert loss.terms["assigned"].item() == pytest.approx(expected, rel=1e-4)


def test_only_the_tokenizer_gets_gradients_while_the_backbone_is_frozen(model, sample):
    TokenizerStage(TINY).loss(model, sample, 0).total.backward()
    assert all(p.grad is None for p in model.backbone.parameters())
    assert sum(p.grad is not None and p.grad.abs().sum() > 0 for p in model.parameters()) > 10
    model.zero_grad(set_to_none=True)


@pytest.mark.parametrize("given", [0.0, 1.0])
def test_every_step_reaches_all_of_the_tokenizer_which_ddp_is_promised(sample, given):
    """Also where nothing is labelled: no group has a partner then."""
    stage = TokenizerStage(replace(TINY, given_probability=given, seg_weight=0.0))
    assert stage.learns_whole
    empty = replace(sample, target_instances=torch.zeros_like(sample.target_instances))
    for each in (sample, empty):
        model = stage.build_model()
        stage.loss(model, each, 0).total.backward()
        assert all(p.grad is not None for p in model.own_parameters())
    assert not TokenizerStage(replace(TINY, freeze_backbone=False)).learns_whole


def test_not_a_number_in_the_renders_is_a_loss_that_is_not_finite(model, sample):
    """Not an error of the matching, so that the loop can save the batch."""
    broken = replace(sample, target=replace(sample.target, images=sample.target.images * np.nan))
    assert not TokenizerStage(TINY).loss(model, broken, 0).total.isfinite()


def test_validation_reports_both_geometries_and_no_instance_is_no_error(model, sample):
    stage = TokenizerStage(TINY)
    empty = replace(sample, target_instances=torch.zeros_like(sample.target_instances))
    with torch.no_grad():
        figures = stage.validate(model.eval(), [sample])
        nothing = stage.validate(model, [empty])
    assert figures.keys() == nothing.keys()
    assert {f"{mode}_{name}" for mode in ("predicted", "given") for name in ("psnr", "ap50")} <= (
        figures.keys()
    )
    assert nothing["given_seg"] == 0
    assert np.isnan(nothing["given_ap"])
    assert figures["given_psnr"] > figures["predicted_psnr"] > 0


def test_weights_of_a_geometry_run_go_into_the_backbone(model):
    stage = TokenizerStage(TINY)
    other = stage.build_model()
    stage.load_initial(other, model.backbone.state_dict())
    name = "stem.stride8.weight"
    assert torch.equal(other.backbone.state_dict()[name], model.backbone.state_dict()[name])
    stage.load_initial(other, model.state_dict())
    assert all(
        torch.equal(a, b) for a, b in zip(other.parameters(), model.parameters(), strict=True)
    )
    with pytest.raises(RuntimeError, match="Missing key"):
        stage.load_initial(other, {"stem.stride8.weight": torch.zeros(1)})


def test_gradient_error_by_hand():
    # Error [[0, 1], [0, 1]]: across, both differences are 1; down, both are 0.
    error = torch.tensor([[0.0, 1.0], [0.0, 1.0]]).expand(3, 2, 2)
    assert gradient_error(error, torch.zeros(3, 2, 2)).item() == 1.0
    assert gradient_error(error + 5, torch.zeros(3, 2, 2)).item() == 1.0


def test_groups_used_leaves_out_the_void_and_losers(model, sample):
    groups = model(sample.context)
    to_first, to_third, to_void = torch.eye(5)[[0, 2, 4]]
    both = torch.stack([to_first, to_void] * 4), torch.stack([to_first, to_third] * 4)
    assert groups_used(replace(groups, assignment=torch.stack(both))) == [1, 2]
    void = to_void.expand(2, 8, 5)
    assert groups_used(replace(groups, assignment=void)) == [0, 0]


def test_true_target_cameras_are_rendered_as_they_are(model, sample):
    """A shift of the true target must show in the loss; aligned ones follow the prediction."""
    stage = TokenizerStage(replace(TINY, given_probability=0.0, target_cameras="true"))
    assert stage.modes == ("predicted",)
    geometry = model.backbone(photos_only(sample.context))
    cameras = cameras_of_targets("true", geometry, sample, "baselines")
    assert torch.equal(cameras.cam_from_world, sample.target.cam_from_world)
    assert torch.equal(cameras.intrinsics, sample.target.intrinsics)
    aligned = cameras_of_targets("aligned", geometry, sample, "baselines")
    assert not torch.allclose(aligned.cam_from_world, cameras.cam_from_world)
    with torch.no_grad():
        figures = stage.validate(model.eval(), [sample])
    assert all(name.startswith("predicted_") for name in figures)


def test_pictures_show_what_was_trained(model, sample):
    both, one = TokenizerStage(TINY), TokenizerStage(replace(TINY, given_probability=0.0))
    with torch.no_grad():
        sheets = [stage.pictures(model.eval(), sample) for stage in (both, one)]
    assert sheets[0].size[0] / 8 == pytest.approx(sheets[1].size[0] / 6, rel=0.1)


def test_weights_of_the_grouping_terms_are_the_configs(model, sample):
    stage = TokenizerStage(
        replace(TINY, given_probability=1.0, seg_weight=0.5, bce_weight=2.0, dice_weight=5.0)
    )
    terms = stage.loss(model, sample, 5).terms
    torch.testing.assert_close(terms["seg_given"], 2 * terms["bce"] + 5 * terms["dice"])


def parts_with_gradient(config: TokenizerStageConfig, sample: Sample) -> set[str]:
    """Parts of a new model to which the loss of a step has a gradient."""
    torch.manual_seed(0)
    model = TokenizerStage(config).build_model()
    TokenizerStage(config).loss(model, sample, 5).total.backward()
    return {
        name.split(".")[0]
        for name, parameter in model.named_parameters()
        if parameter.grad is not None and parameter.grad.abs().max() > 0
    }


def test_rendering_and_grouping_are_trained_alone_where_it_is_asked(sample):
    config = replace(TINY, assignment_weight=0.1)
    of_groups = {"group_decoder", "assign"}
    of_pictures = parts_with_gradient(replace(config, trained="rendering"), sample)
    assert parts_with_gradient(replace(config, trained="grouping"), sample) == of_groups
    assert of_pictures == {"fuse", "place", "anchor_decoder", "gaussian_head"}
    assert parts_with_gradient(config, sample) == of_pictures | of_groups


def test_losses_of_the_two_halves_are_those_of_the_whole(model, sample):
    config = replace(TINY, assignment_weight=0.1)
    whole, pictures, groups = (
        TokenizerStage(replace(config, trained=part)).loss(model, sample, 5)
        for part in ("all", "rendering", "grouping")
    )
    torch.testing.assert_close(pictures.total + groups.total, whole.total)
    assert groups.terms.keys() == whole.terms.keys()
    assert "dice" not in pictures.terms


def test_training_of_grouping_alone_starts_from_a_tokenizer(model):
    stage = TokenizerStage(replace(TINY, trained="grouping"))
    other = stage.build_model()
    stage.load_initial(other, model.state_dict())
    assert all(torch.equal(v, other.state_dict()[k]) for k, v in model.state_dict().items())
    backbone = {k: v for k, v in model.state_dict().items() if k.startswith("backbone.")}
    with pytest.raises(RuntimeError, match="no tokenizer, of which grouping alone"):
        stage.load_initial(other, backbone)
    assert stage.config.first_weights().wanted == "a tokenizer that has learned to render"


@pytest.mark.parametrize("wrong", [{"freeze_backbone": False}, {"seg_weight": 0.0}])
def test_grouping_alone_needs_a_frozen_backbone_and_its_loss(wrong):
    with pytest.raises(ValueError, match="grouping alone is trained"):
        replace(TINY, trained="grouping", **wrong)
