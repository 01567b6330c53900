from collections.abc import Sequence
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from fake_rooms import FakeRooms
from instok3d.data.batches import make_sample
from instok3d.data.view_sampling import FrameChoice
from instok3d.data.words import ObjectWords
from instok3d.evaluation import semantic_lifting
from instok3d.evaluation.semantic_lifting import (
    ANCHOR,
    BOTH,
    ENCODER,
    FITTED,
    GAUSSIANS,
    GROUP,
    KINDS,
    PERFECT,
    PIXELS,
    LiftedScene,
    feature_maps,
    lifted_scene,
    measure_lifting,
    table,
)
from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.tokenizer import Tokenizer, TokenizerConfig
from instok3d.semantics.classes import PHRASES
from instok3d.semantics.model import SemanticModel
from instok3d.semantics.tokens import SemanticTokensConfig, render_semantics
from plane_backbone import PlaneBackbone, PlaneConfig

WORDS = {0: ObjectWords("wall"), 1: ObjectWords("bed"), 2: ObjectWords("sofa"),
         3: ObjectWords("chair")}  # fmt: skip
CHANNELS = len(PHRASES)


class Constant:
    """Sees a sofa everywhere."""

    name, channels = "constant", CHANNELS

    def features(self, images: Tensor) -> Tensor:
        one = self.text(["sofa"])[0]
        return one[None, :, None, None].expand(len(images), -1, 16, 16).contiguous()

    def text(self, texts: Sequence[str]) -> Tensor:
        return torch.eye(CHANNELS)[[PHRASES.index(text) for text in texts]]

    def crop(self, image: Tensor) -> Tensor:
        raise ValueError("no crops")


def made() -> tuple[Tokenizer, SemanticModel]:
    torch.manual_seed(0)
    sizes = TokenizerConfig(
        width=32, num_anchors=60, num_groups=4, anchor_layers=1, group_layers=1, head_size=16,
        gaussian_head=GaussianHeadConfig(gaussians_per_anchor=4),
    )  # fmt: skip
    tokenizer = Tokenizer(PlaneBackbone(PlaneConfig()), sizes).eval().requires_grad_(False)
    config = SemanticTokensConfig(feature_channels=CHANNELS, residual_channels=2, group_layers=1)
    return tokenizer, SemanticModel(tokenizer, config)


@pytest.fixture(scope="module")
def scene() -> LiftedScene:
    tokenizer, model = made()
    sample = make_sample(FakeRooms(1, size=32), 0, FrameChoice((6, 10), (8,)))
    sample = replace(sample, words=(WORDS,))
    return lifted_scene(tokenizer, model, Constant(), sample)


def test_a_scene_has_its_context_views_and_then_its_targets(scene: LiftedScene):
    assert (scene.num_context, len(scene.photos), len(scene.cameras.cam_from_world)) == (2, 3, 3)
    true = scene.groups.geometry.cameras.cam_from_world[0]
    torch.testing.assert_close(scene.cameras.cam_from_world[:2], true)
    assert (scene.classes[0][scene.instances == 2] == PHRASES.index("sofa")).all()


def test_both_levels_together_are_the_sum_of_each_alone(scene: LiftedScene):
    phrases = Constant().text(PHRASES)
    both, group, anchor = (feature_maps(scene, kind, phrases) for kind in (BOTH, GROUP, ANCHOR))
    torch.testing.assert_close(both[0], group[0] + anchor[0], atol=1e-5, rtol=1e-5)
    assert anchor[0].abs().max() > 0
    assert both[1] == group[1] + anchor[1] == scene.tokens.num_scalars
    # L x D and N x d numbers.
    anchors = scene.groups.assignment.shape[1]
    assert (group[1], anchor[1]) == (scene.tokens.shared.shape[1] * CHANNELS, 2 * anchors)


@pytest.mark.parametrize("kind", [GAUSSIANS, PIXELS])
def test_features_of_single_gaussians_are_those_of_a_constant_encoder(kind, scene: LiftedScene):
    maps, stored = feature_maps(scene, kind, Constant().text(PHRASES))
    count = {GAUSSIANS: len(scene.groups.gaussians.means[0]), PIXELS: 2 * 64 * 64}[kind]
    assert stored == count * CHANNELS
    covered = maps[:, PHRASES.index("sofa")]
    others = maps.sum(dim=1) - covered
    assert covered.max() > 0.5
    assert covered.max() <= 1 + 1e-4
    torch.testing.assert_close(others, torch.zeros_like(others), atol=1e-4, rtol=0)


def test_a_pixel_of_the_photos_shows_the_feature_that_lies_there(scene: LiftedScene):
    halves = torch.zeros_like(scene.encoder)
    halves[:, 0, :, :8] = 1.0
    halves[:, 1, :, 8:] = 1.0
    maps, _ = feature_maps(replace(scene, encoder=halves), PIXELS, Constant().text(PHRASES))
    left, right = maps[0, 0], maps[0, 1]
    assert (left > right)[:, :14].float().mean() > 0.95
    assert (right > left)[:, 18:].float().mean() > 0.95


def test_the_class_of_a_group_is_that_of_most_of_its_pixels(scene: LiftedScene):
    maps = render_semantics(
        scene.groups.gaussians, scene.groups.assignment, scene.tokens, scene.cameras.batched(),
        32, 32,
    ).shares[0, :, :, 0]  # fmt: skip
    number = int(maps.sum(dim=(0, 2, 3)).argmax())
    ids = torch.where(maps.argmax(dim=1) == number, 3, 0)
    words = {3: WORDS[3]}
    classes = torch.where(ids == 3, PHRASES.index(words[3].label), -1)[None].expand(2, -1, -1, -1)
    found, _ = feature_maps(replace(scene, classes=classes), PERFECT, Constant().text(PHRASES))
    mine = maps.argmax(dim=1) == number
    assert (found.argmax(dim=1)[mine] == PHRASES.index("chair")).float().mean() > 0.99


def test_fitted_groups_have_the_mean_direction_of_what_is_seen_of_them(scene: LiftedScene):
    phrases = Constant().text(PHRASES)
    fitted, stored = feature_maps(scene, FITTED, phrases)
    assert stored == feature_maps(scene, BOTH, phrases)[1]
    # The encoder sees a sofa everywhere: so does every group, with the residuals on top.
    anchor, _ = feature_maps(scene, ANCHOR, phrases)
    shared = (fitted - anchor)[:, PHRASES.index("sofa")]
    others = (fitted - anchor).abs().sum(dim=1) - shared.abs()
    torch.testing.assert_close(others, torch.zeros_like(others), atol=1e-4, rtol=0)
    lengths = scene.tokens.shared[0, :, 0].norm(dim=1)
    assert shared.max() <= lengths.max() + 1e-4
    assert shared.max() > 0.5 * lengths.min()


def test_fitting_moves_the_shared_features_of_a_group_together(scene: LiftedScene):
    one, apart = scene.tokens, torch.linspace(-1, 1, CHANNELS)
    anchors = one.mixing.shape[1]
    mixing = torch.rand(1, anchors, 2, generator=torch.Generator().manual_seed(1)).softmax(-1)
    two = replace(
        one, shared=torch.cat([one.shared + apart, one.shared - apart], dim=2), mixing=mixing
    )
    known = replace(scene, tokens=two)
    size = (scene.photos.shape[-2], scene.photos.shape[-1])
    maps = render_semantics(
        scene.groups.gaussians, scene.groups.assignment, two, scene.cameras.batched(), *size
    )
    found = semantic_lifting._fitted(known, maps).shared[0]
    torch.testing.assert_close(found[:, 0] - found[:, 1], (2 * apart).expand(len(found), -1))
    # The mean of a group that is seen, by what is seen of each, points to the sofa.
    seen = maps.shares[0, : scene.num_context].sum(dim=(0, 3, 4))
    means = torch.einsum("gk,gkd->gd", seen / seen.sum(dim=1, keepdim=True), found)
    for group in (seen.sum(dim=1) > 1).nonzero()[:, 0].tolist():
        assert int(means[group].argmax()) == PHRASES.index("sofa")
        others = means[group].abs().sum() - means[group].max()
        assert float(others) == pytest.approx(0, abs=1e-3)
    phrases = Constant().text(PHRASES)
    assert feature_maps(known, FITTED, phrases)[1] == two.num_scalars


def test_the_encoder_agrees_with_itself_and_names_what_it_sees(scene: LiftedScene):
    found = measure_lifting([scene, scene], Constant(), (ENCODER, GAUSSIANS))
    encoder = found[ENCODER]
    assert encoder.cosines["target"] == pytest.approx([1.0, 1.0])
    truth = scene.classes[0]
    share = (truth[2] == PHRASES.index("sofa")).float().mean()
    known = (truth[2] >= 0).float().mean()
    assert encoder.target.rooms.accuracy() == pytest.approx(float(share / known))
    assert encoder.source.rooms.counts.sum() == 2 * (truth[:2] >= 0).sum()
    assert found[GAUSSIANS].scalars == [len(scene.groups.gaussians.means[0]) * CHANNELS] * 2


def test_a_table_has_a_row_for_each_kind_and_no_scene_gives_no_number(scene: LiftedScene):
    rows = table(measure_lifting([scene], Constant())).splitlines()
    assert [row.split(" | ")[0].strip("| ") for row in rows[2:]] == list(KINDS)
    assert len({row.count("|") for row in rows}) == 1
    empty = table(measure_lifting([], Constant(), (BOTH,)))
    assert empty.count("nan / nan") == 4


def test_more_than_one_scene_at_once_is_refused():
    tokenizer, model = made()
    sample = make_sample(FakeRooms(1, size=32), 0, FrameChoice((6, 10), (8,)))
    with pytest.raises(ValueError, match="samples of one scene, got 2"):
        lifted_scene(
            tokenizer, model, Constant(), replace(sample, names=("a", "b"), words=({}, {}))
        )
