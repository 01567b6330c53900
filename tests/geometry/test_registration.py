from dataclasses import replace

import torch

from instok3d.geometry.cameras import invert_rigid, transform_points
from instok3d.geometry.registration import (
    MatchedPoints,
    best_loops,
    compose_along_tree,
    register_pair,
    rigid_from_twist,
    spanning_tree,
)
from instok3d.geometry.rotations import angle_between_rad


def two_views(
    rng: torch.Generator, depth_error: float
) -> tuple[torch.Tensor, MatchedPoints, MatchedPoints]:
    """A cloud before two cameras, with exact rays and depths that are wrong by a random factor."""
    b_from_a = rigid_from_twist(torch.tensor([[0.3, -0.1, 0.2, 0.05, 0.3, -0.1]]))
    rays = torch.rand(1, 400, 2, generator=rng) - 0.5
    depth = 1 + 2 * torch.rand(1, 400, 1, generator=rng)
    points_a = torch.cat([rays, torch.ones_like(depth)], dim=-1) * depth
    points_b = transform_points(b_from_a, points_a)

    def spoil(points: torch.Tensor) -> torch.Tensor:
        return points * (1 + depth_error * torch.randn(1, 400, 1, generator=rng))

    seen_in_a, seen_in_b = (
        points_a[..., :2] / points_a[..., 2:],
        points_b[..., :2] / points_b[..., 2:],
    )
    confidence = torch.ones(1, 400)
    a = MatchedPoints(spoil(points_a), seen_in_b, spoil(points_b), confidence)
    return b_from_a, a, MatchedPoints(spoil(points_b), seen_in_a, spoil(points_a), confidence)


def test_exact_matches_give_the_exact_camera(rng):
    true, a, b = two_views(rng, depth_error=0.0)
    torch.testing.assert_close(register_pair(a, b), true, atol=1e-4, rtol=1e-4)


def test_errors_of_depth_hardly_turn_the_camera(rng):
    true, a, b = two_views(rng, depth_error=0.15)
    found = register_pair(a, b)
    angle = torch.rad2deg(angle_between_rad(found[0, :3, :3], true[0, :3, :3]))
    assert float(angle) < 1.0


def test_a_third_of_wrong_matches_is_outvoted(rng):
    true, a, b = two_views(rng, depth_error=0.05)
    a.rays[:, :130] = torch.rand(1, 130, 2, generator=rng) - 0.5
    a.matched[:, :130] = torch.randn(1, 130, 3, generator=rng)
    found = register_pair(a, b)
    angle = torch.rad2deg(angle_between_rad(found[0, :3, :3], true[0, :3, :3]))
    assert float(angle) < 1.0


def test_matches_that_nobody_trusts_give_a_finite_camera(rng):
    _, a, b = two_views(rng, depth_error=0.0)
    silenced = (replace(way, confidence=torch.zeros_like(way.confidence)) for way in (a, b))
    assert register_pair(*silenced).isfinite().all()


def test_tree_takes_the_strong_links():
    # 0-1 is weak (0.1) although 1 is reached well over 2: 0-2 (0.9), then 2-1 (0.8).
    scores = torch.tensor([[0, 0.1, 0.9], [0, 0, 0.8], [0, 0, 0]])
    assert spanning_tree(scores) == [(0, 2), (2, 1)]
    assert spanning_tree(torch.zeros(1, 1)) == []


def test_loops_are_the_best_pairs_outside_the_tree():
    # The tree takes 0-2 and 2-1; of 0-1 (0.1), 0-3, 1-3 and 2-3 the tree below takes 2-3.
    scores = torch.tensor([[0, 0.1, 0.9, 0.3], [0, 0, 0.8, 0.2], [0, 0, 0, 0.7], [0, 0, 0, 0]])
    tree = spanning_tree(scores)
    assert tree == [(0, 2), (2, 1), (2, 3)]
    assert best_loops(scores, tree, 2) == [(0, 3), (1, 3)]
    assert best_loops(scores, tree, 9) == [(0, 3), (1, 3), (0, 1)]
    assert best_loops(torch.zeros(1, 1), [], 3) == []


def test_cameras_compose_along_the_tree_in_both_directions(rng):
    cam_from_first = rigid_from_twist(torch.randn(3, 6, generator=rng))
    cam_from_first[0] = torch.eye(4)
    one_from_two = cam_from_first[1] @ invert_rigid(cam_from_first[2])
    relative = {(0, 2): cam_from_first[2], (1, 2): invert_rigid(one_from_two)}
    composed = compose_along_tree(relative, [(0, 2), (2, 1)])
    torch.testing.assert_close(composed, cam_from_first, atol=1e-5, rtol=1e-5)


def test_a_single_view_is_the_world():
    torch.testing.assert_close(compose_along_tree({}, []), torch.eye(4)[None])
