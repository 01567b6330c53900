from dataclasses import replace

import pytest
import torch
from torch.nn.functional import normalize

from instok3d.objectives.distillation import distillation_loss
from instok3d.semantics.tokens import (
    SemanticDecoder,
    SemanticTokens,
    SemanticTokensConfig,
    pixel_features,
    render_semantics,
)
from instok3d.types import Cameras, Gaussians

SIDE = 16
CONFIG = SemanticTokensConfig(feature_channels=3, residual_channels=2, group_layers=1)


def two_walls() -> tuple[Gaussians, Cameras, torch.Tensor]:
    """Two sheets of Gaussians, left and right of the middle; the left anchor is of group 0."""
    x, y = torch.meshgrid(torch.linspace(-1, 1, 24), torch.linspace(-1, 1, 24), indexing="xy")
    means = torch.stack([x.flatten(), y.flatten(), torch.full((576,), 2.0)], dim=1)
    made = Gaussians(
        means, torch.tensor([1.0, 0, 0, 0]).expand(576, 4), torch.full((576, 3), 0.05),
        torch.full((576,), 0.9), torch.zeros(576, 1, 3), (means[:, 0] > 0).long(),
    )  # fmt: skip
    camera = Cameras(
        torch.eye(4).expand(1, 1, 4, 4),
        torch.tensor([[SIDE, 0, SIDE / 2], [0, SIDE, SIDE / 2], [0, 0, 1.0]]).expand(1, 1, 3, 3),
    )
    return made.batched(), camera, torch.tensor([[[0.7, 0.2, 0.1], [0.1, 0.3, 0.6]]])


def tokens(basis: int = 1) -> SemanticTokens:
    shared = torch.zeros(1, 2, basis, 3)
    shared[0, 0, :, 0] = 1
    shared[0, 1, :, 1] = 1
    return SemanticTokens(
        shared,
        torch.zeros(1, 2, 2),
        torch.full((1, 2, basis), 1 / basis),
        torch.tensor([[0.0, 0], [0, 0], [2, 1]]),
    )


def features(made: SemanticTokens) -> torch.Tensor:
    gaussians, camera, assignment = two_walls()
    maps = render_semantics(gaussians, assignment, made, camera, SIDE, SIDE)
    return pixel_features(maps, made)[0, 0]


def test_a_pixel_has_the_shared_feature_of_its_group():
    found = normalize(features(tokens()), dim=0)
    torch.testing.assert_close(found[:, 8, 3], torch.tensor([1.0, 0, 0]))
    # The right anchor is rather of the void than of group 1: it takes the feature of group 1.
    torch.testing.assert_close(found[:, 8, 12], torch.tensor([0.0, 1, 0]))


def test_residuals_add_what_their_map_says():
    made = replace(tokens(), residuals=torch.tensor([[[0.5, 0.0], [0.0, 3.0]]]))
    found = features(made)
    torch.testing.assert_close(found[:, 8, 3] / found[0, 8, 3], torch.tensor([1.0, 0, 1]))
    torch.testing.assert_close(found[:, 8, 12] / found[1, 8, 12], torch.tensor([0.0, 1, 3]))


def test_anchors_mix_the_shared_features_of_their_group():
    made = tokens(2)
    made.shared[0, 0, 1] = torch.tensor([0.0, 0, 1])
    made = replace(made, mixing=torch.tensor([[[0.25, 0.75], [1, 0]]]))
    found = features(made)
    torch.testing.assert_close(found[:, 8, 3] / found[0, 8, 3], torch.tensor([1.0, 0, 3]))
    torch.testing.assert_close(normalize(found[:, 8, 12], dim=0), torch.tensor([0.0, 1, 0]))


def test_two_shared_features_give_the_halves_of_one_group_exactly():
    # Both anchors are of group 0: the left one has its first feature, the right one its second.
    gaussians, camera, _ = two_walls()
    assignment = torch.tensor([[[0.7, 0.2, 0.1], [0.6, 0.3, 0.1]]])
    halves = torch.tensor([[0.6, 0.0, 0.8], [0.0, -1.0, 0.0]])
    made = tokens(2)
    made = replace(
        made,
        shared=torch.stack([halves, torch.ones(2, 3)])[None],
        mixing=torch.tensor([[[1.0, 0], [0, 1]]]),
    )
    maps = render_semantics(gaussians, assignment, made, camera, SIDE, SIDE)
    found = pixel_features(maps, made)[0, 0]
    left = maps.shares[0, 0, 0, 0] > 0
    right = maps.shares[0, 0, 0, 1] > 0
    for half, only in ((0, left & ~right), (1, right & ~left)):
        assert only.sum() >= 6 * SIDE
        wanted = maps.shares[0, 0, 0, half, only] * halves[half][:, None]
        assert torch.equal(found[:, only], wanted)
    # Where both show, F is what Eq. 7 makes of their shares.
    mixed = torch.einsum("khw,kd->dhw", maps.shares[0, 0, 0], halves)
    torch.testing.assert_close(found, mixed)


@pytest.mark.parametrize(("levels", "there"), [("group", "shared"), ("anchor", "residuals")])
def test_one_level_alone_leaves_the_other_at_zero(rng, levels, there):
    torch.manual_seed(0)
    decoder = SemanticDecoder(16, replace(CONFIG, levels=levels), head_size=8)
    semantic, groups = (torch.randn(1, count, 16, generator=rng) for count in (2, 2))
    made = decoder(semantic, groups)
    zero = {"shared", "residuals"} - {there}
    assert vars(made)[there].all()
    assert not vars(made)[zero.pop()].any()
    gaussians, camera, assignment = two_walls()
    maps = render_semantics(gaussians, assignment, made, camera, SIDE, SIDE)
    lifted = pixel_features(maps, made)
    teacher = torch.randn(1, 1, 3, SIDE, SIDE, generator=rng)
    distillation_loss(lifted, maps.shares, made.shared, teacher).total.backward()
    assert all(p.grad is not None and p.grad.any() for p in decoder.parameters())


def test_anchors_alone_have_no_several_shared_features():
    with pytest.raises(ValueError, match="num_basis is 2, but levels 'anchor' has no shared"):
        SemanticTokensConfig(levels="anchor", num_basis=2)


def test_a_constant_teacher_is_met_exactly():
    gaussians, camera, assignment = two_walls()
    constant = torch.tensor([0.6, 0.0, 0.8])
    made = tokens()
    made = replace(made, shared=constant.expand(1, 2, 1, 3))
    maps = render_semantics(gaussians, assignment, made, camera, SIDE, SIDE)
    teacher = constant[:, None, None].expand(1, 1, 3, SIDE, SIDE)
    lifted = pixel_features(maps, made)
    loss = distillation_loss(lifted, maps.shares, made.shared, teacher)
    assert float(loss.total) == pytest.approx(0, abs=1e-6)


def test_the_papers_scene_stores_59392_numbers():
    paper = SemanticTokensConfig()
    assert (paper.feature_channels, paper.residual_channels, paper.group_layers) == (512, 8, 4)
    decoder = SemanticDecoder(64, paper)
    with torch.no_grad():
        made = decoder(torch.zeros(1, 1024, 64), torch.zeros(1, 100, 64))
    assert made.num_scalars == 100 * 512 + 1024 * 8 == 59_392
    mixed = SemanticDecoder(64, replace(paper, num_basis=2))
    with torch.no_grad():
        made = mixed(torch.zeros(1, 1024, 64), torch.zeros(1, 100, 64))
    assert made.num_scalars == 2 * 100 * 512 + 1024 * 8 + 1024 * 2


def test_everything_of_the_decoder_learns_and_nothing_before_it(rng):
    gaussians, camera, assignment = two_walls()
    means = gaussians.means.clone().requires_grad_()
    decoder = SemanticDecoder(16, replace(CONFIG, num_basis=2), head_size=8)
    semantic = torch.randn(1, 2, 16, generator=rng)
    groups = torch.randn(1, 2, 16, generator=rng, requires_grad=True)
    made = decoder(semantic, groups)
    maps = render_semantics(
        replace(gaussians, means=means), assignment, made, camera, SIDE, SIDE
    )  # fmt: skip
    lifted = pixel_features(maps, made)
    teacher = torch.randn(1, 1, 3, SIDE, SIDE, generator=rng)
    distillation_loss(lifted, maps.shares, made.shared, teacher).total.backward()
    assert all(p.grad is not None and p.grad.any() for p in decoder.parameters())
    assert means.grad is groups.grad is None


def test_scenes_without_groups_or_gaussians_have_no_features():
    gaussians, camera, assignment = two_walls()
    empty = SemanticTokens(torch.zeros(1, 0, 1, 3), *list(vars(tokens()).values())[1:])
    maps = render_semantics(gaussians, assignment[..., 2:], empty, camera, SIDE, SIDE)
    assert not pixel_features(maps, empty).any()
    none = gaussians.map(lambda tensor: tensor[:, :0])
    maps = render_semantics(none, assignment, tokens(), camera, SIDE, SIDE)
    assert not pixel_features(maps, tokens()).any()
    loss = distillation_loss(
        pixel_features(maps, tokens()),
        maps.shares,
        tokens().shared,
        torch.ones(1, 1, 3, SIDE, SIDE),
    )
    assert (float(loss.pixels), float(loss.groups)) == (1, 0)


@pytest.mark.parametrize("name", ["feature_channels", "residual_channels", "num_basis"])
def test_a_size_of_nothing_is_named(name):
    with pytest.raises(ValueError, match=f"{name} must be at least 1, got 0"):
        SemanticTokensConfig(**{name: 0})  # pyright: ignore[reportArgumentType]
