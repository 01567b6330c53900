from math import log

import pytest
import torch

from instok3d.geometry.spherical_harmonics import SH_CONSTANT
from instok3d.model.gaussian_head import GaussianHead, GaussianHeadConfig
from instok3d.types import Anchors, Context, Gaussians


def flat_wall(*, patches: int = 6, cells_per_side: int = 2, channels: int = 8) -> Context:
    """A row of patches 0.4 wide on the plane z = 1, each with 2 x 2 cells 0.2 apart."""
    steps = 0.2 * (torch.arange(cells_per_side) - (cells_per_side - 1) / 2)
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    around = torch.stack([x, y, torch.zeros_like(x)], dim=-1).flatten(0, 1)
    centers = torch.zeros(patches, 3)
    centers[:, 0], centers[:, 2] = 0.4 * torch.arange(patches), 1.0
    colors = torch.linspace(0, 1, patches * len(around) * 3).view(patches, -1, 3)
    cells = torch.cat([centers[:, None] + around, colors], dim=-1)
    tokens = torch.randn(1, patches, channels, generator=torch.Generator().manual_seed(0))
    return Context(tokens, centers[None], cells[None], torch.ones(1))


def anchors_on(context: Context, patches: list[int]) -> Anchors:
    picked = torch.tensor([patches])
    return Anchors(context.positions[:, patches], context.tokens[:, patches], picked)


def without_mlp(head: GaussianHead) -> GaussianHead:
    torch.nn.init.zeros_(head.out.weight)
    return head


def saying(head: GaussianHead) -> GaussianHead:
    """Whatever the anchor: offset 0.5, 0, -0.5; log scales log 2, -log 2, 0; quaternion 3, 0, 4, 0;
    opacity log 3; colour 2 in every coefficient."""
    numbers = torch.full((sum(head.sizes),), 2.0)
    told = [0.5, 0, -0.5, log(2), -log(2), 0, 3, 0, 4, 0, log(3)]
    numbers[: len(told)] = torch.tensor(told)
    with torch.no_grad():
        head.out.bias.copy_(numbers.repeat(head.config.gaussians_per_anchor))
    return without_mlp(head)


def assert_told(gaussians: Gaussians, *, starts: torch.Tensor, bound: float, scale: float) -> None:
    """What `saying` says, from these places and this scale."""
    # tanh(0.5) = 0.462117; a twice, half and once as large deviation.
    offset = bound * torch.tensor([0.462117, 0, -0.462117])
    torch.testing.assert_close(
        gaussians.means - starts, offset.expand_as(starts), rtol=1e-4, atol=1e-6
    )
    scales = scale * torch.tensor([2, 0.5, 1])
    torch.testing.assert_close(gaussians.scales, scales.expand_as(starts))
    quats = torch.tensor([0.6, 0, 0.8, 0])
    torch.testing.assert_close(gaussians.quats, quats.expand_as(gaussians.quats))
    # 3 / (3 + 1).
    torch.testing.assert_close(gaussians.opacities, torch.full_like(gaussians.opacities, 0.75))


SURFACE = GaussianHeadConfig(gaussians_per_anchor=4)


def test_what_the_head_says_moves_gaussians_from_their_cells_by_hand():
    # Cells are 0.2 apart: at most 4 x 0.2 = 0.8 away, 0.6 x 0.2 = 0.12 wide.
    context = flat_wall()
    gaussians = saying(GaussianHead(8, SURFACE))(anchors_on(context, [0, 1, 2, 3, 4, 5]), context)
    cells = context.cells.flatten(1, 2)
    assert_told(gaussians, starts=cells[..., :3], bound=0.8, scale=0.12)
    # The constant is added to that of the cell's colour, the next band is an eighth.
    constant = (cells[..., 3:] - 0.5) / SH_CONSTANT + 2
    torch.testing.assert_close(gaussians.sh[..., 0, :], constant)
    torch.testing.assert_close(gaussians.sh[..., 1:, :], torch.full((1, 24, 3, 3), 2 / 8))


def test_what_the_head_says_moves_gaussians_from_their_anchor_by_hand():
    context = flat_wall()
    config = GaussianHeadConfig(gaussians_per_anchor=5, seeding="anchor", sh_degree=2)
    anchors = anchors_on(context, [0, 2, 5])
    gaussians = saying(GaussianHead(8, config))(anchors, context)
    starts = anchors.positions.repeat_interleave(5, dim=1)
    assert_told(gaussians, starts=starts, bound=0.1, scale=0.03)
    sh = torch.tensor([2.0] + [2 / 8] * 3 + [2 / 32] * 5)
    torch.testing.assert_close(gaussians.sh, sh[:, None].expand(1, 15, 9, 3))


def test_surface_gaussians_start_on_their_cells_in_their_colours():
    context = flat_wall()
    head = without_mlp(GaussianHead(8, SURFACE))
    gaussians = head(anchors_on(context, [0, 1, 2, 3, 4, 5]), context)
    cells = context.cells.flatten(1, 2)
    torch.testing.assert_close(gaussians.means, cells[..., :3])
    torch.testing.assert_close(0.5 + SH_CONSTANT * gaussians.sh[..., 0, :], cells[..., 3:])
    # 0.6 of a cell of 0.2; the identity; sigmoid(1).
    torch.testing.assert_close(gaussians.scales, torch.full((1, 24, 3), 0.12))
    torch.testing.assert_close(gaussians.quats[0, 0], torch.tensor([1.0, 0, 0, 0]))
    torch.testing.assert_close(gaussians.opacities, torch.full((1, 24), 0.73106))
    assert gaussians.anchor_index[0].tolist() == [k for k in range(6) for _ in range(4)]


def test_sparse_anchors_spread_and_grow():
    # Two anchors on six patches, 1.2 apart = 3 patch widths; 6 / 2 = 3 patches for each allow it.
    context = flat_wall()
    config = GaussianHeadConfig(gaussians_per_anchor=4, scale_max=1.0)
    gaussians = without_mlp(GaussianHead(8, config))(anchors_on(context, [1, 4]), context)
    torch.testing.assert_close(gaussians.scales, torch.full((1, 8, 3), 0.36))
    relative = gaussians.means[:, :4] - context.positions[:, 1:2]
    torch.testing.assert_close(relative, 3 * (context.cells[:, 1, :, :3] - context.positions[:, 1]))
    colors = 0.5 + SH_CONSTANT * gaussians.sh[:, :4, 0]
    mean = context.cells[:, 1, :, 3:].mean(1)
    torch.testing.assert_close(colors, mean + (context.cells[:, 1, :, 3:] - mean) / 3)


def test_one_anchor_alone_is_finite():
    context = flat_wall(patches=1)
    gaussians = GaussianHead(8, SURFACE)(anchors_on(context, [0]), context)
    assert gaussians.means.isfinite().all()
    assert gaussians.scales.isfinite().all()


def test_an_edge_through_a_patch_does_not_blow_its_gaussians_up():
    context = flat_wall(patches=1, cells_per_side=4)
    context.cells[0, 0, 8:, 2] += 2.0  # the lower half lies 2 behind the upper half
    config = GaussianHeadConfig(gaussians_per_anchor=16)
    gaussians = without_mlp(GaussianHead(8, config))(anchors_on(context, [0]), context)
    torch.testing.assert_close(gaussians.scales, torch.full((1, 16, 3), 0.12))


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
def test_anchor_seeded_gaussians_keep_the_papers_bounds(rng, sh_degree):
    context = flat_wall()
    config = GaussianHeadConfig(gaussians_per_anchor=5, seeding="anchor", sh_degree=sh_degree)
    head = GaussianHead(8, config)
    torch.nn.init.normal_(head.out.weight, std=10.0, generator=rng)  # as wild as training may get
    anchors = anchors_on(context, [0, 2, 5])
    gaussians = head(anchors, context)
    offsets = gaussians.means.unflatten(1, (3, 5)) - anchors.positions[:, :, None]
    assert offsets.abs().max() <= 0.1 + 1e-6
    assert offsets.abs().max() > 0.099
    assert gaussians.scales.max() <= 0.3 + 1e-6
    assert gaussians.scales.min() > 0
    assert ((gaussians.opacities >= 0) & (gaussians.opacities <= 1)).all()
    torch.testing.assert_close(gaussians.quats.norm(dim=-1), torch.ones(1, 15))
    assert gaussians.sh.shape == (1, 15, (sh_degree + 1) ** 2, 3)


def test_higher_bands_are_damped():
    damping = GaussianHead(8, GaussianHeadConfig(gaussians_per_anchor=4, sh_degree=3)).damping
    assert damping.flatten().tolist() == [1.0] + [1 / 8] * 3 + [1 / 32] * 5 + [1 / 128] * 7


@pytest.mark.parametrize("count", [1, 8, 15])
def test_surface_seeding_wants_a_square_number(count):
    with pytest.raises(ValueError, match=f"must be 4, 9, 16, ..., got {count}"):
        GaussianHeadConfig(gaussians_per_anchor=count)


def test_an_unknown_degree_is_named():
    with pytest.raises(ValueError, match="sh_degree must be 0, 1, 2 or 3, got 4"):
        GaussianHeadConfig(sh_degree=4)
