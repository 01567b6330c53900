import torch

from instok3d.baselines.seeding import (
    SeedPoints,
    seed_points,
    seeded_gaussians,
    voted_labels,
    world_points,
)
from instok3d.evaluation.methods import Shown
from instok3d.types import Views

FOCAL = 4.0


def two_views() -> Shown:
    """A board (id 7) 1 before a wall (id 9) at 2: the left camera sees it in its left half, and
    one that stands on the right sees the wall behind it too."""
    intrinsics = torch.tensor([[FOCAL, 0, 4], [0, FOCAL, 4], [0, 0, 1]]).expand(1, 2, 3, 3)
    cam_from_world = torch.eye(4).repeat(1, 2, 1, 1)
    cam_from_world[0, 1, 0, 3] = -2.0  # the second camera stands at x = 2
    ids = torch.full((2, 8, 8), 9)
    ids[0, :, :4] = 7
    depths = torch.where(ids == 7, 1.0, 2.0)[None]
    images = torch.rand(1, 2, 3, 8, 8, generator=torch.Generator().manual_seed(0))
    return Shown(Views(images, intrinsics, cam_from_world, depths), ids)


def test_points_lie_behind_their_pixels_with_their_colours():
    shown = two_views()
    points = seed_points(shown, 1000, seed=0)
    assert len(points.positions) == 128
    assert set(points.positions[:, 2].tolist()) == {1.0, 2.0}
    # Pixel (0, 7) of the second view: ray (3.5 / 4, -3.5 / 4, 1) times 2, from x = 2.
    at = (points.positions - torch.tensor([3.75, -1.75, 2.0])).norm(dim=1).argmin()
    torch.testing.assert_close(points.positions[at], torch.tensor([3.75, -1.75, 2.0]))
    torch.testing.assert_close(points.colors[at], shown.views.images[0, 1, :, 0, 7])


def test_fewer_points_are_drawn_by_the_seed():
    first, again, other = (seed_points(two_views(), 20, seed=seed) for seed in (1, 1, 2))
    assert len(first.positions) == 20
    assert torch.equal(first.positions, again.positions)
    assert not torch.equal(first.positions, other.positions)


def test_a_gaussian_is_as_large_as_its_distance_to_the_nearest_points():
    positions = torch.tensor([[0.0, 0, 1], [1, 0, 1], [0, 1, 1], [0, 0, 2]])
    gaussians = seeded_gaussians(SeedPoints(positions, torch.full((4, 3), 0.5)), sh_degree=1)
    torch.testing.assert_close(gaussians.scales[0], torch.ones(3))
    torch.testing.assert_close(gaussians.scales[1], torch.full((3,), (1 + 2 * 2**0.5) / 3))
    assert gaussians.sh.shape == (4, 4, 3)
    assert not gaussians.sh.any()
    alone = SeedPoints(positions[:1], torch.zeros(1, 3))
    assert seeded_gaussians(alone, sh_degree=0).scales.isfinite().all()


def test_a_hidden_point_takes_no_vote_of_what_hides_it():
    shown = two_views()
    points = world_points(shown)
    board, wall = points[0, 4, 1], points[1, 4, 0]
    # The wall's point lies behind the board in the first view (x = 0.25 at z = 2: column 4), so
    # it is taken to column 1 there.
    hidden = torch.tensor([-1.0, 0.25, 2.0])
    behind, outside = torch.tensor([0.0, 0, -1]), torch.tensor([90.0, 0, 2])
    labels = voted_labels(torch.stack([board, wall, hidden, behind, outside]), shown)
    assert labels.tolist() == [7, 9, 0, 0, 0]


def test_one_vote_for_a_thing_counts_more_than_any_for_none():
    shown = two_views()
    assert shown.masks is not None
    seen_by_both = world_points(shown)[1, 4, 0][None]
    masks = shown.masks.clone()
    masks[1] = 0
    assert voted_labels(seen_by_both, Shown(shown.views, masks)).tolist() == [9]


def test_ids_of_no_thing_do_not_vote_and_no_point_has_no_label():
    shown = two_views()
    assert shown.masks is not None
    unknown = Shown(shown.views, torch.where(shown.masks == 7, -1, 0))
    assert voted_labels(world_points(shown).view(-1, 3), unknown).tolist() == [0] * 128
    assert voted_labels(torch.zeros(0, 3), shown).tolist() == []
