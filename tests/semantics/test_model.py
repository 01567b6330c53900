from dataclasses import replace

import pytest
import torch

from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.tokenizer import Tokenizer, TokenizerConfig
from instok3d.model.views.windows import cut_window, middle_windows, view_windows
from instok3d.semantics.model import PatchLift, SemanticModel, at_patches
from instok3d.semantics.tokens import SemanticTokensConfig
from instok3d.types import Views
from plane_backbone import PlaneBackbone, PlaneConfig

SIZES = TokenizerConfig(
    width=32,
    num_anchors=200,
    num_groups=6,
    window_views=3,
    anchor_layers=2,
    group_layers=1,
    head_size=16,
    gaussian_head=GaussianHeadConfig(gaussians_per_anchor=4),
)
CONFIG = SemanticTokensConfig(feature_channels=5, residual_channels=2, group_layers=1)


def made(**changes) -> tuple[Tokenizer, SemanticModel]:
    torch.manual_seed(0)
    tokenizer = Tokenizer(PlaneBackbone(PlaneConfig()), replace(SIZES, **changes))
    tokenizer.eval().requires_grad_(False)
    return tokenizer, SemanticModel(tokenizer, CONFIG)


def inputs(rng: torch.Generator, views: int, batch: int = 1) -> tuple[Views, torch.Tensor]:
    photos = Views(torch.rand(batch, views, 3, 32, 32, generator=rng))
    return photos, torch.randn(batch, views, 5, 16, 16, generator=rng)


@pytest.mark.parametrize("views", [1, 2, 5])
def test_the_scene_is_that_without_semantics_bit_for_bit(rng, views):
    tokenizer, model = made()
    photos, features = inputs(rng, views, batch=2)
    groups, tokens = model(tokenizer, photos, features)
    alone = tokenizer(photos)
    assert torch.equal(groups.assignment, alone.assignment)
    assert torch.equal(groups.tokens, alone.tokens)
    assert torch.equal(groups.anchors.tokens, alone.anchors.tokens)
    assert torch.equal(groups.gaussians.means, alone.gaussians.means)
    assert alone.anchors.lifted is None
    assert tokens.shared.shape == (2, groups.tokens.shape[1], 1, 5)
    assert tokens.residuals.shape == (2, groups.anchors.tokens.shape[1], 2)


def test_several_shared_features_begin_as_the_one(rng):
    tokenizer, one = made()
    two = SemanticModel(tokenizer, replace(CONFIG, num_basis=2))
    photos, features = inputs(rng, 2)
    assert two.decoder.mixing is not None
    before = two.decoder.mixing.weight.clone()
    two.start_from(one)
    tokens, wanted = (model(tokenizer, photos, features)[1] for model in (two, one))
    torch.testing.assert_close(tokens.shared, wanted.shared.expand(-1, -1, 2, -1))
    assert torch.equal(tokens.residuals, wanted.residuals)
    # Only how anchors mix them is new: nothing else would ever tell the two apart.
    assert torch.equal(two.decoder.mixing.weight, before)
    assert before.any()


@pytest.mark.parametrize("levels", ["group", "anchor"])
def test_one_level_begins_with_its_part_of_both(rng, levels):
    tokenizer, whole = made()
    part = SemanticModel(tokenizer, replace(CONFIG, levels=levels))
    part.start_from(whole)
    photos, features = inputs(rng, 2)
    found, wanted = (model(tokenizer, photos, features)[1] for model in (part, whole))
    assert torch.equal(found.shared, wanted.shared * (levels == "group"))
    assert torch.equal(found.residuals, wanted.residuals * (levels == "anchor"))


def test_other_sizes_do_not_begin():
    tokenizer, one = made()
    for sizes in (replace(CONFIG, residual_channels=3), replace(CONFIG, num_basis=2)):
        other = SemanticModel(tokenizer, sizes)
        with pytest.raises(ValueError, match=r"weights of sizes .* do not fit"):
            one.start_from(other)


def test_anchors_carry_their_semantic_tokens_through_windows(rng):
    tokenizer, model = made()
    photos, features = inputs(rng, 5)
    groups, _ = model(tokenizer, photos, features)
    seen = tokenizer.backbone(photos)
    windows = view_windows(seen, 0, 3)
    lift = PatchLift(model.stream, at_patches(features, 4, 4))
    assert groups.anchors.lifted is not None
    for view, number in middle_windows(windows).items():
        window = windows[number]
        part = tokenizer.tokenize(
            *cut_window(photos, seen, 0, window), draw=False, lift=lift.cut(0, window)
        )
        here = groups.anchors.patches[0] // 16 == view
        there = part.anchors.patches[0] // 16 == window.index(view)
        assert part.anchors.lifted is not None
        found, expected = groups.anchors.lifted[0, here], part.anchors.lifted[0, there]
        order, other = (
            which.anchors.patches[0, mask].remainder(16).argsort()
            for which, mask in ((groups, here), (part, there))
        )
        torch.testing.assert_close(found[order], expected[other])


def test_features_are_lifted_in_the_windows_alone_that_anchors_come_from(rng, monkeypatch):
    tokenizer, model = made()
    photos, features = inputs(rng, 5)
    windows = view_windows(tokenizer.backbone(photos), 0, 3)
    cut, lifted = PatchLift.cut, []
    monkeypatch.setattr(
        PatchLift,
        "cut",
        lambda self, scene, window: lifted.append(window) or cut(self, scene, window),
    )
    model(tokenizer, photos, features)
    assert lifted == [windows[number] for number in sorted({*middle_windows(windows).values()})]
    assert len(lifted) < len(windows)


def test_the_tokenizer_stays_and_the_semantics_learn_through_windows(rng):
    tokenizer, model = made()
    groups, tokens = model(tokenizer, *inputs(rng, 5))
    assert not groups.gaussians.means.requires_grad
    (tokens.shared.square().sum() + tokens.residuals.square().sum()).backward()
    gradients = {name: p.grad for name, p in model.named_parameters()}
    assert {name for name, grad in gradients.items() if grad is None} == {
        "decoder.residual_map.weight"  # of rendered features alone
    }


def test_features_at_patches_are_means_of_finer_maps_and_row_major():
    maps = torch.arange(16.0).view(1, 1, 1, 4, 4)
    coarse = at_patches(maps, 2, 2)
    assert coarse.shape == (1, 1, 4, 1)
    assert coarse[0, 0, :, 0].diff().gt(0).all()
    assert float(coarse.mean()) == pytest.approx(float(maps.mean()))
    assert torch.equal(at_patches(maps, 4, 4)[0, 0, :, 0], maps.flatten())
