"""Gaussians that another view sees through: by hand, at discontinuities, in the tokenizer."""

from dataclasses import replace

import pytest
import torch

from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.tokenizer import PAPER, Tokenizer, TokenizerConfig
from instok3d.model.views.free_space import KEPT, count_seen_through, prune_free_space
from instok3d.types import Anchors, Cameras, Gaussians, Geometry, TokenGroups, Views
from plane_backbone import PlaneBackbone, PlaneConfig

SIZE = 16


def walls(*distances: float, shift: float = 0.0) -> Geometry:
    """Views side by side, each in front of a wall of its own distance."""
    count = len(distances)
    depths = torch.stack([torch.full((SIZE, SIZE), d) for d in distances])[None]
    cam_from_world = torch.eye(4).repeat(1, count, 1, 1)
    cam_from_world[0, :, 0, 3] = -shift * torch.arange(count)
    intrinsics = torch.tensor([[16.0, 0, 8], [0, 16.0, 8], [0, 0, 1]]).repeat(1, count, 1, 1)
    return Geometry(
        features=torch.zeros(1, count, 4, 1),
        depths=depths,
        pointmaps=torch.zeros(1, count, SIZE, SIZE, 3),
        confidences=torch.ones_like(depths),
        cameras=Cameras(cam_from_world, intrinsics),
    )


def at(*points: tuple[float, float, float]) -> Gaussians:
    count = len(points)
    return Gaussians(
        means=torch.tensor(points).view(1, count, 3),
        quats=torch.tensor([1.0, 0, 0, 0]).expand(1, count, 4),
        scales=torch.full((1, count, 3), 0.1),
        opacities=torch.full((1, count), 0.8),
        sh=torch.zeros(1, count, 1, 3),
        anchor_index=torch.arange(count)[None],
    )


def votes(gaussians: Gaussians, geometry: Geometry, source: int = 0) -> list[float]:
    from_view = torch.full(gaussians.anchor_index.shape, source)
    return count_seen_through(gaussians, from_view, geometry)[0].tolist()


def test_views_that_see_a_farther_wall_are_counted():
    # Views 1 and 2 see a wall at 2 and at 4. At depth 1.9 (5 % in front of 2) both see through,
    # at 1.95 (2.5 %) and at 3 view 2 alone, at 5, behind both walls, nobody can say.
    points = at((0, 0, 1.9), (0, 0, 1.95), (0, 0, 3.0), (0, 0, 5.0))
    assert votes(points, walls(9.0, 2.0, 4.0)) == [2, 1, 1, 0]


def test_its_own_view_is_not_asked():
    assert votes(at((0, 0, 1.0)), walls(2.0, 2.0), source=0) == [1]
    assert votes(at((0, 0, 1.0)), walls(2.0), source=0) == [0]


def test_behind_a_camera_and_outside_its_image_nothing_is_seen():
    points = at((0, 0, -1.0), (5.0, 0, 1.0), (0, -5.0, 1.0), (0, 0, 0))
    assert votes(points, walls(9.0, 9.0)) == [0, 0, 0, 0]


def test_the_camera_of_each_view_counts():
    # View 1 stands 2 to the right: x = 2 is its middle, x = 0 lies outside of its 45 degrees.
    points = at((2.0, 0, 1.0), (0.0, 0, 1.0))
    assert votes(points, walls(9.0, 9.0, shift=2.0)) == [1, 0]


def test_beside_a_near_rim_nothing_is_said():
    geometry = walls(9.0, 9.0)
    geometry.depths[0, 1, :, 9:] = 1.0
    # Columns 7 and 8 look past the thing, but 8 passes it by one pixel.
    points = at((-0.5 / 16, 0, 1.0), (0.5 / 16, 0, 1.0))
    assert votes(points, geometry) == [1, 0]


def groups_at(gaussians: Gaussians, geometry: Geometry, patches: torch.Tensor) -> TokenGroups:
    count = patches.shape[1]
    return TokenGroups(
        anchors=Anchors(torch.zeros(1, count, 3), torch.zeros(1, count, 2), patches),
        tokens=torch.zeros(1, 1, 2),
        assignment=torch.full((1, count, 2), 0.5),
        gaussians=gaussians,
        geometry=geometry,
    )


def test_each_vote_leaves_a_share_of_the_opacity_and_nothing_else_changes():
    # Four patches a view: anchors 0 and 1 lie on view 0 and view 2.
    geometry = walls(2.0, 2.0, 4.0)
    groups = groups_at(at((0, 0, 1.0), (0, 0, 3.0)), geometry, torch.tensor([[1, 9]]))
    pruned = prune_free_space(groups)
    # The first is looked through by views 1 and 2; the second lies behind the walls of 0 and 1.
    expected = torch.tensor([[0.8 * KEPT**2, 0.8]])
    torch.testing.assert_close(pruned.gaussians.opacities, expected)
    assert torch.equal(pruned.gaussians.means, groups.gaussians.means)
    assert pruned.anchors is groups.anchors


def test_gradient_passes_through_the_opacities():
    opacities = torch.full((1, 1), 0.5, requires_grad=True)
    gaussians = replace(at((0, 0, 1.0)), opacities=opacities)
    groups = groups_at(gaussians, walls(2.0, 2.0), torch.tensor([[0]]))
    prune_free_space(groups).gaussians.opacities.sum().backward()
    torch.testing.assert_close(opacities.grad, torch.full((1, 1), KEPT))


def test_no_gaussians_are_none():
    nothing = Gaussians(**{name: value[:, :0] for name, value in vars(at((0, 0, 1.0))).items()})
    groups = groups_at(nothing, walls(2.0, 2.0), torch.zeros(1, 0, dtype=torch.long))
    assert prune_free_space(groups).gaussians.opacities.shape == (1, 0)


SMALL = TokenizerConfig(
    width=32,
    num_anchors=64,
    num_groups=4,
    anchor_layers=1,
    group_layers=1,
    head_size=16,
    gaussian_head=GaussianHeadConfig(gaussians_per_anchor=4),
)


@pytest.mark.parametrize("views", [2, 6])
def test_the_tokenizer_thins_out_the_whole_scene_unless_told_not_to(rng, views):
    assert SMALL.thin_free_space
    assert not PAPER.thin_free_space
    torch.manual_seed(0)
    tokenizer = Tokenizer(PlaneBackbone(PlaneConfig()), SMALL).eval()
    photos = Views(torch.rand(1, views, 3, 32, 32, generator=rng))
    with torch.no_grad():
        geometry = tokenizer.backbone(photos)
        geometry.depths[:, 0] *= 3  # view 0 sees through all that the others see
        pruned = tokenizer(photos, geometry)
        tokenizer.config = replace(SMALL, thin_free_space=False)
        whole = tokenizer(photos, geometry)
    expected = prune_free_space(whole).gaussians.opacities
    torch.testing.assert_close(pruned.gaussians.opacities, expected)
    assert (expected < whole.gaussians.opacities).any()
