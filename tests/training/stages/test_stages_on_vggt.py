"""The stages of the paper's presets on a VGGT of a few thousand parameters."""

from dataclasses import replace

import pytest
import torch

from fake_rooms import FakeRooms
from instok3d.backbones.vggt import VGGTBackbone
from instok3d.data.batches import BatchConfig, SceneBatches
from instok3d.data.sample import Sample
from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.pixel_gaussians import PixelGaussianConfig
from instok3d.model.tokenizer import TokenizerConfig
from instok3d.training.config import preset
from instok3d.training.first_weights import load_backbone
from instok3d.training.stages.adapt import AdaptStage
from instok3d.training.stages.tokenizer import TokenizerStage
from instok3d.training.update import parameter_groups
from tiny_vggt import TINY_VGGT

VGGT = replace(TINY_VGGT, img_size=32, intrinsics_token=True)
PAIRS = BatchConfig(1, views=(2,), num_targets=3, photometric=False, sampling="scannet")


@pytest.fixture(scope="module")
def sample() -> Sample:
    return SceneBatches(FakeRooms(1, size=32), [0], PAIRS, seed=0).batch(0)


def adapt_stage() -> AdaptStage:
    config = preset("scannet-adapt").stage
    head = PixelGaussianConfig(width=8, sh_degree=0)
    return AdaptStage(replace(config, backbone=VGGT, head=head, lpips_weight=0.0))


def tokenizer_stage() -> TokenizerStage:
    config = preset("scannet-2view").stage
    sizes = TokenizerConfig(
        width=64, num_anchors=8, num_groups=4, anchor_layers=1, group_layers=1,
        normalize_scale=False, project_assignment=False,
        gaussian_head=GaussianHeadConfig(gaussians_per_anchor=4, seeding="anchor"),
    )  # fmt: skip
    return TokenizerStage(replace(config, backbone=VGGT, tokenizer=sizes, lpips_weight=0.0))


def test_an_adapt_step_reaches_all_that_pointmaps_depend_on(sample):
    stage = adapt_stage()
    torch.manual_seed(0)
    model = stage.build_model()
    loss = stage.loss(model, sample, 0)
    loss.total.backward()
    assert loss.total.isfinite()
    backbone = model.backbone
    assert isinstance(backbone, VGGTBackbone)
    wanted = {id(p) for p in backbone.adapted_parameters()}
    assert {id(p) for p in backbone.parameters() if p.requires_grad} == wanted
    assert {id(p) for p in backbone.parameters() if p.grad is not None} == wanted
    with torch.no_grad():
        assert {"psnr", "unit", "depth_rel"} == stage.validate(model.eval(), [sample]).keys()


def test_the_backbone_learns_slower_than_its_head_and_its_intrinsics_layer():
    model = adapt_stage().build_model()
    groups = parameter_groups(model, 0.05, backbone_lr_factor=0.1, backbone_weight_decay=0.0)
    names = {id(p): name for name, p in model.named_parameters()}
    found = {names[id(p)]: g for g in groups for p in g["params"]}
    assert found.keys() == {n for n, p in model.named_parameters() if p.requires_grad}
    for name, group in found.items():
        slow = name.startswith("backbone.") and "embed_intrinsics" not in name
        assert group["lr_factor"] == (0.1 if slow else 1.0), name
        assert not (slow and group["weight_decay"]), name
    assert found["head.mix.weight"]["weight_decay"] == 0.05
    assert len(parameter_groups(model, 0.05)) == 2


def test_a_tokenizer_step_starts_from_the_adapted_backbone_and_leaves_it_as_it_is(sample):
    adapted, stage = adapt_stage().build_model(), tokenizer_stage()
    model = stage.build_model()
    stage.load_initial(model, adapted.state_dict())
    for name, value in adapted.backbone.state_dict().items():
        assert torch.equal(model.backbone.state_dict()[name], value)
    with torch.autocast("cpu", torch.bfloat16):
        loss = stage.loss(model, sample, 2_000)
    loss.total.backward()
    terms = loss.terms
    expected = terms["mse_predicted"] + 0.1 * (terms["bce"] + terms["dice"])
    torch.testing.assert_close(loss.total.detach(), expected)
    assert all(p.grad is None for p in model.backbone.parameters())
    assert all(p.grad is not None for p in model.own_parameters())
    with torch.no_grad():
        assert all(n.startswith("predicted_") for n in stage.validate(model.eval(), [sample]))


def test_three_targets_of_two_views_are_the_middle_and_the_contexts(sample):
    contexts, targets = sample.context.images[0], sample.target.images[0]
    assert len(targets) == 3
    assert torch.equal(targets[1:], contexts)
    assert not torch.equal(targets[0], contexts[0])


def test_published_weights_are_brought_to_the_papers_patches():
    """Patches of 14 become 16; what tracks pixels is left; the layer for intrinsics stays new."""
    torch.manual_seed(1)
    published = VGGTBackbone(replace(TINY_VGGT, img_size=28, patch_size=14)).vggt.state_dict()
    backbone = VGGTBackbone(VGGT)
    load_backbone(backbone, {**published, "track_head.x": torch.ones(1)})
    layer = backbone.vggt.aggregator.embed_intrinsics
    assert layer.bias.eq(0).all()
    assert layer.weight.std().item() == pytest.approx((2 / 9) ** 0.5, rel=0.3)
    found = backbone.vggt.state_dict()
    changed = {n for n, value in published.items() if not torch.equal(found[n], value)}
    assert changed == {"aggregator.patch_embed.patch_embed.proj.weight"}
    assert found["aggregator.patch_embed.patch_embed.proj.weight"].shape == (32, 3, 16, 16)
    published.pop("camera_head.token_norm.weight")
    with pytest.raises(RuntimeError, match="Missing key"):
        load_backbone(backbone, published)
