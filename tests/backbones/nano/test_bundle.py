"""Bundle adjustment of cameras and coarse depth: exact data, wrong depth, false pairs, no data."""

from dataclasses import fields, replace

import pytest
import torch

from instok3d.backbones.nano import bundle, native_kernels
from instok3d.backbones.nano.bundle import adjust_bundle
from instok3d.backbones.nano.bundle_equations import (
    NormalEquations,
    native_equations,
    normal_equations,
)
from instok3d.backbones.nano.bundle_errors import point_errors
from instok3d.backbones.nano.bundle_problem import BundleNoise, Observations, SolveSettings
from instok3d.backbones.nano.depth_grid import node_weights
from instok3d.backbones.nano.native_kernels import kernels
from instok3d.geometry.cameras import invert_rigid, transform_points
from instok3d.geometry.registration import rigid_from_twist
from instok3d.geometry.rotations import angle_between_rad

GRID = (4, 4)
POINTS = 400
PRECISION = torch.eye(2) / 0.006**2
"""Of a ray: wrong by 0.006 in x/z and y/z."""


def cameras_on_a_path(count: int) -> torch.Tensor:
    """cam_from_first of cameras side by side that turn a little."""
    steps = torch.tensor([0.25, -0.05, 0.05, 0.02, 0.06, -0.02]) * torch.arange(count)[:, None]
    return rigid_from_twist(steps)


def observe(
    rng: torch.Generator,
    cam_from_first: torch.Tensor,
    pairs: list[tuple[int, int]],
    log_error: torch.Tensor,
) -> Observations:
    """Exact rays of points at depths 2 to 3, in both directions; depths have the nodes' errors.

    log_error [view, node] is added to log depth, by the node weights.
    """
    rows = []
    for here, there in [*pairs, *((b, a) for a, b in pairs)]:
        positions = torch.rand(POINTS, 2, generator=rng)
        depth = 2 + torch.rand(POINTS, 1, generator=rng)
        points = torch.cat([positions - 0.5, torch.ones(POINTS, 1)], dim=-1) * depth
        there_from_here = cam_from_first[there] @ invert_rigid(cam_from_first[here])
        seen = transform_points(there_from_here, points)
        rays = seen[:, :2] / seen[:, 2:]
        positions_there = rays + 0.5
        wrong_here = (node_weights(positions, GRID) @ log_error[here]).exp()
        wrong_there = (node_weights(positions_there, GRID) @ log_error[there]).exp()
        inside = ((positions_there > 0) & (positions_there < 1)).all(-1)
        rows.append(
            (
                torch.tensor(0),
                torch.tensor(here),
                torch.tensor(there),
                points * wrong_here[:, None],
                rays,
                PRECISION.expand(POINTS, 2, 2),
                seen[:, 2] * wrong_there,
                inside.float(),
                positions,
                positions_there,
            )
        )
    return Observations(*(torch.stack(each) for each in zip(*rows, strict=True)))


def free(count: int, *, focal: bool = False) -> SolveSettings:
    """The depth of all views may change."""
    return SolveSettings(torch.ones(1, count), focal_is_free=focal)


def turn_error_deg(found: torch.Tensor, true: torch.Tensor) -> float:
    return float(torch.rad2deg(angle_between_rad(found[0, :, :3, :3], true[:, :3, :3])).max())


def test_exact_matches_bring_wrong_cameras_back_and_leave_the_depth(rng):
    true = cameras_on_a_path(3)
    observations = observe(rng, true, [(0, 1), (1, 2), (0, 2)], torch.zeros(3, 16))
    start = rigid_from_twist(0.03 * torch.randn(3, 6, generator=rng)) @ true
    start[0] = true[0]
    cameras, changes, _ = adjust_bundle(observations, start[None], free(3), GRID, iterations=12)
    torch.testing.assert_close(cameras[0], true, atol=2e-3, rtol=0)
    torch.testing.assert_close(changes, torch.zeros(1, 3, 16), atol=5e-3, rtol=0)


def test_any_number_of_threads_gives_the_same_bits(rng):
    """Of so many pairs and nodes that threads could share out what adds them up."""
    true = cameras_on_a_path(5)
    pairs = [(a, b) for a in range(5) for b in range(a)]
    observations = observe(rng, true, pairs, torch.zeros(5, 16))
    # Both ways of a pair one behind the other, so that both threads add to the same blocks.
    order = torch.arange(2 * len(pairs)).view(2, -1).T.flatten()
    observations = Observations(
        *(getattr(observations, field.name)[order] for field in fields(observations))
    )
    start = rigid_from_twist(0.03 * torch.randn(5, 6, generator=rng)) @ true
    start[0] = true[0]
    threads, found = torch.get_num_threads(), []
    try:
        for count in (2, 2, 1):
            torch.set_num_threads(count)
            found.append(adjust_bundle(observations, start[None], free(5), (8, 8)))
    finally:
        torch.set_num_threads(threads)
    for again in found[1:]:
        assert all(torch.equal(*both) for both in zip(found[0], again, strict=True))


def test_wrong_depth_is_found_together_with_the_cameras(rng):
    true = cameras_on_a_path(3)
    # Each view has an error of its own; what is common to all is the length of a unit.
    error = 0.1 * torch.randn(3, 16, generator=rng)
    error = error - error.mean()
    observations = observe(rng, true, [(0, 1), (1, 2), (0, 2)], error)
    start = rigid_from_twist(0.02 * torch.randn(3, 6, generator=rng)) @ true
    start[0] = true[0]
    cameras, changes, _ = adjust_bundle(observations, start[None], free(3), GRID)
    left = error + changes[0]
    left = left - left.mean()
    assert left.std() < 0.4 * error.std()
    assert turn_error_deg(cameras, true) < 0.3


def test_known_depth_stays(rng):
    true = cameras_on_a_path(2)
    error = torch.zeros(2, 16)
    error[1] = 0.1 * torch.randn(16, generator=rng)
    observations = observe(rng, true, [(0, 1)], error)
    _, changes, _ = adjust_bundle(
        observations, true[None], SolveSettings(torch.tensor([[0.0, 1.0]])), GRID
    )
    assert changes[0, 0].abs().max() < 1e-3
    assert changes[0, 1].abs().max() > 0.03


def test_a_pair_that_contradicts_the_others_changes_nothing(rng):
    true = cameras_on_a_path(4)
    observations = observe(rng, true, [(0, 1), (1, 2), (2, 3), (0, 3)], torch.zeros(4, 16))
    false = (observations.here - observations.there).abs() == 3
    rays = torch.where(false[:, None, None], observations.rays + 0.4, observations.rays)
    start = (rigid_from_twist(0.01 * torch.randn(4, 6, generator=rng)) @ true)[None]
    start[0, 0] = true[0]
    everything = free(4)
    with_it, *_ = adjust_bundle(replace(observations, rays=rays), start, everything, GRID)
    kept = {name: value[~false] for name, value in vars(observations).items()}
    without, *_ = adjust_bundle(Observations(**kept), start, everything, GRID)
    torch.testing.assert_close(with_it, without, atol=1e-5, rtol=0)


@pytest.mark.parametrize("confidence", [0.0, 0.4])
def test_matches_of_low_confidence_change_nothing(rng, confidence):
    true = cameras_on_a_path(2)
    observations = observe(rng, true, [(0, 1)], torch.ones(2, 16))
    unsure = replace(observations, confidence=torch.full_like(observations.confidence, confidence))
    cameras, changes, _ = adjust_bundle(unsure, true[None], free(2), GRID)
    torch.testing.assert_close(cameras[0], true, atol=1e-5, rtol=0)
    assert changes.abs().max() < 1e-6


def test_points_behind_the_other_camera_are_left_out(rng):
    turned_away = torch.eye(4).repeat(2, 1, 1)
    turned_away[1, 0, 0] = turned_away[1, 2, 2] = -1
    observations = observe(rng, cameras_on_a_path(2), [(0, 1)], torch.zeros(2, 16))
    cameras, changes, _ = adjust_bundle(observations, turned_away[None], free(2), GRID)
    torch.testing.assert_close(cameras[0], turned_away, atol=1e-5, rtol=0)
    assert changes.isfinite().all()


def test_without_another_view_everything_stays(rng):
    nothing = observe(rng, cameras_on_a_path(2), [(0, 1)], torch.zeros(2, 16))
    nothing = Observations(**{name: value[:0] for name, value in vars(nothing).items()})
    for count in (1, 3):
        start = cameras_on_a_path(count)[None]
        cameras, changes, _ = adjust_bundle(nothing, start, free(count), GRID)
        assert torch.equal(cameras, start)
        assert changes.shape == (1, count, 16)
        assert changes.count_nonzero() == 0


def test_a_ray_counts_as_far_as_it_is_precise(rng):
    # Rays that are wrong by 0.05 up or down, but known across alone: as if nothing were wrong.
    true = cameras_on_a_path(2)
    exact = observe(rng, true, [(0, 1)], torch.zeros(2, 16))
    sideways = torch.tensor([[1 / 0.006**2, 0.0], [0.0, 1e-2]]).expand_as(exact.precision)
    wrong = torch.stack([torch.zeros(2, POINTS), 0.05 * torch.ones(2, POINTS)], dim=-1)
    start = true[None]
    blind = replace(exact, rays=exact.rays + wrong, precision=sideways)
    cameras, *_ = adjust_bundle(blind, start, free(2), GRID)
    torch.testing.assert_close(cameras, start, atol=2e-3, rtol=0)
    seeing = replace(exact, rays=exact.rays + wrong)
    cameras, *_ = adjust_bundle(seeing, start, free(2), GRID)
    assert (cameras - start).abs().max() > 0.02


def test_fine_depth_error_loosens_a_ray_along_its_parallax_alone(rng):
    # By hand, for one point: covariance = 1 / precision + fine^2 slope slope^T.
    observations = observe(rng, cameras_on_a_path(2), [(0, 1)], torch.zeros(2, 16))
    mixed = torch.tensor([[4e4, 1e4], [1e4, 2e4]]).expand_as(observations.precision)
    observations = replace(observations, precision=mixed)
    noise = BundleNoise(fine_depth=0.05, independence=1.0, outlier=1e6)
    there_from_here = cameras_on_a_path(2)[[1, 0]] @ invert_rigid(cameras_on_a_path(2)[[0, 1]])
    nothing = torch.zeros(2, POINTS)
    known = torch.zeros(2)
    errors = point_errors(observations, there_from_here, nothing, nothing, known, noise)
    plain = point_errors(
        replace(observations, precision=torch.eye(2).expand_as(mixed)),
        there_from_here, nothing, nothing, known, replace(noise, fine_depth=0.0),
    )  # fmt: skip
    slope = plain.by_depth_here[..., :2]
    covariance = mixed.inverse() + 0.05**2 * slope[..., :, None] * slope[..., None, :]
    rows, plain_rows = errors.by_twist[..., :2, :], plain.by_twist[..., :2, :]
    expected = plain_rows.mT @ covariance.inverse() @ plain_rows
    seen = observations.confidence > 0
    torch.testing.assert_close((rows.mT @ rows)[seen], expected[seen], rtol=1e-3, atol=1.0)


def test_gradient_is_that_of_the_robust_errors(rng):
    # Without fine_depth the weights depend on the errors alone, and the gradient of Gauss-Newton
    # is that of share * outlier^2 / 2 * log(1 + (error / outlier)^2).
    noise = BundleNoise(fine_depth=0.0)
    true = cameras_on_a_path(2)
    found = observe(rng, true, [(0, 1)], 0.1 * torch.randn(2, 16, generator=rng))
    doubled = {n: v.double() if v.is_floating_point() else v for n, v in vars(found).items()}
    mixed = torch.tensor([[4e4, 1e4], [1e4, 2e4]]).double().expand(2, POINTS, 2, 2)
    observations = Observations(**{**doubled, "precision": mixed})
    start = (rigid_from_twist(0.05 * torch.randn(2, 6, generator=rng)) @ true).double()
    nodes = 0.1 * torch.randn(1, 2, 16, generator=rng).double()
    here, there = (
        node_weights(p, GRID) for p in (observations.positions_here, observations.positions_there)
    )
    log_focal = torch.tensor([0.07]).double()
    equations = normal_equations(observations, here, there, noise, start[None], nodes, log_focal)

    twist = torch.zeros(2, 6, dtype=torch.double, requires_grad=True)
    moved_nodes, focal = nodes.clone().requires_grad_(), log_focal.clone().requires_grad_()
    cameras = rigid_from_twist(twist) @ start
    cost = torch.zeros((), dtype=torch.double)
    for row, (a, b) in enumerate([(0, 1), (1, 0)]):
        points = observations.points[row] * torch.cat([(-focal).exp().expand(2), torch.ones(1)])
        points = points * (here[row] @ moved_nodes[0, a]).exp()[:, None]
        seen = transform_points(cameras[b] @ invert_rigid(cameras[a]), points)
        off = focal.exp() * seen[:, :2] / seen[:, 2:] - observations.rays[row]
        ray = ((off @ mixed[0, 0]) * off).sum(-1)
        log_depth = observations.depths[row].log() + there[row] @ moved_nodes[0, b]
        depth = ((seen[:, 2].log() - log_depth) / noise.mutual_depth).square()
        share = noise.independence * observations.confidence[row]
        for error in (ray, depth):
            cost = cost + (share * noise.outlier**2 / 2 * (error / noise.outlier**2).log1p()).sum()
    by_twist, by_nodes, by_focal = torch.autograd.grad(cost, (twist, moved_nodes, focal))
    gradient = equations.gradient
    torch.testing.assert_close(gradient[0, :, :6], by_twist, atol=1e-8, rtol=1e-6)
    torch.testing.assert_close(gradient[..., 6:], by_nodes, atol=1e-8, rtol=1e-6)
    torch.testing.assert_close(equations.focal_gradient, by_focal, atol=1e-8, rtol=1e-6)


needs_kernels = pytest.mark.skipif(kernels is None, reason="the kernels are not built")


def wrong_everything(rng: torch.Generator) -> tuple[Observations, *tuple[torch.Tensor, ...]]:
    """Two scenes of four views on a grid of 4 x 4: observations, cameras, corrections, focal."""
    true = cameras_on_a_path(4)
    pairs = [[(0, 1), (1, 2), (0, 3)], [(1, 3), (2, 0), (2, 3)]]
    scenes = [observe(rng, true, each, 0.1 * torch.randn(4, 16, generator=rng)) for each in pairs]
    parts = {name: torch.cat([vars(scene)[name] for scene in scenes]) for name in vars(scenes[0])}
    parts["scenes"] = torch.arange(2).repeat_interleave(len(scenes[0].here))
    mixed = torch.tensor([[4e4, 1e4], [1e4, 2e4]])
    parts["precision"] = mixed * (0.5 + torch.rand(12, POINTS, 1, 1, generator=rng))
    parts["confidence"] = parts["confidence"] * torch.rand(12, POINTS, generator=rng)
    cameras = rigid_from_twist(0.05 * torch.randn(2, 4, 6, generator=rng)) @ true
    cameras[1, 3, :3, :3] = torch.diag(torch.tensor([-1.0, 1.0, -1.0]))  # looks away
    corrections = 0.1 * torch.randn(2, 4, 16, generator=rng)
    return Observations(**parts), cameras, corrections, torch.tensor([0.07, -0.2])


@needs_kernels
def test_the_kernels_add_up_what_the_reference_does(rng):
    observations, *at = wrong_everything(rng)
    weights = [
        node_weights(p, GRID) for p in (observations.positions_here, observations.positions_there)
    ]
    exact = normal_equations(observations, *weights, BundleNoise(), *at)
    fast = native_equations(observations, GRID, BundleNoise(), *at)
    # Of 20 blocks all but the six of the view that looks away and of the one paired with it alone.
    assert (exact.hessian != 0).flatten(3).any(-1).sum() == 2 * (4 + 2 * 3) - 6
    for name, value in vars(exact).items():
        torch.testing.assert_close(
            getattr(fast, name), value, rtol=1e-5, atol=1e-6 * float(value.abs().max()), msg=name
        )


@needs_kernels
def test_the_kernels_solve_for_what_the_reference_solves_for(rng, monkeypatch):
    true = cameras_on_a_path(3)
    error = 0.1 * torch.randn(3, 16, generator=rng)
    observations = observe(rng, true, [(0, 1), (1, 2), (0, 2)], error)
    start = true[None]
    found = adjust_bundle(observations, start, free(3, focal=True), GRID)
    monkeypatch.setattr(native_kernels, "kernels", None)
    exact = adjust_bundle(observations, start, free(3, focal=True), GRID)
    for ours, theirs in zip(found, exact, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-4)
    assert exact[1].abs().max() > 0.02


@needs_kernels
def test_the_kernels_refuse_views_and_scenes_that_do_not_exist(rng):
    observations, *at = wrong_everything(rng)
    for name, wrong in (("scenes", 2), ("here", 4), ("there", -1)):
        indices = vars(observations)[name].clone()
        indices[3] = wrong
        with pytest.raises(ValueError, match=f"{name.removesuffix('s')} has {wrong}"):
            native_equations(replace(observations, **{name: indices}), GRID, BundleNoise(), *at)


@needs_kernels
def test_the_kernels_make_zeros_of_no_observations(rng):
    observations, *at = wrong_everything(rng)
    nothing = Observations(**{name: value[:0] for name, value in vars(observations).items()})
    for value in vars(native_equations(nothing, GRID, BundleNoise(), *at)).values():
        assert value.count_nonzero() == 0


def test_a_wrong_focal_length_is_found_where_it_is_free(rng):
    # Points and rays as they seem where the focal length is 1.1 times what it is taken for. Most of
    # that is found; short paths do not tell all.
    true = cameras_on_a_path(4)
    pairs = [(0, 1), (1, 2), (2, 3), (0, 2), (1, 3)]
    observations = observe(rng, true, pairs, torch.zeros(4, 16))
    taken = torch.tensor([1.1, 1.1, 1.0])
    wrong = replace(
        observations, points=observations.points * taken, rays=observations.rays * taken[:2]
    )
    start = true[None]
    cameras, _, log_focal = adjust_bundle(wrong, start, free(4, focal=True), GRID, iterations=20)
    torch.testing.assert_close(log_focal, torch.tensor([1.1]).log(), atol=0.03, rtol=0)
    assert turn_error_deg(cameras, true) < 0.3
    *_, log_focal = adjust_bundle(wrong, start, free(4), GRID, iterations=20)
    assert log_focal.item() == 0


def test_pairs_agree_with_the_focal_length_that_was_solved_for(rng):
    # A camera turned by 0.6 radians: points that are placed with a focal length 2.5 times wrong do
    # not come out where they are seen. With nearly parallel cameras they would.
    true = cameras_on_a_path(2)
    true[1] = rigid_from_twist(torch.tensor([-1.5, 0.0, 0.5, 0.0, 0.6, 0.0])) @ true[0]
    observations = observe(rng, true, [(0, 1)], torch.zeros(2, 16))
    taken = torch.tensor([2.5, 2.5, 1.0])
    wrong = replace(
        observations, points=observations.points * taken, rays=observations.rays * taken[:2]
    )
    solved = bundle._agreement_weights(wrong, true[None], torch.tensor([2.5]).log(), 0.15)
    torch.testing.assert_close(
        solved, bundle._agreement_weights(observations, true[None], torch.zeros(1), 0.15)
    )
    assert solved.max() > 0.9
    assert bundle._agreement_weights(wrong, true[None], torch.zeros(1), 0.15).max() == 0


def test_a_right_focal_length_stays(rng):
    true = cameras_on_a_path(3)
    observations = observe(rng, true, [(0, 1), (1, 2), (0, 2)], torch.zeros(3, 16))
    *_, log_focal = adjust_bundle(observations, true[None], free(3, focal=True), GRID)
    assert log_focal.abs().item() < 1e-3


def test_a_focal_length_that_nothing_speaks_for_goes_back_to_the_guess_by_hand(rng):
    # Without a confident match only the prior is left, whose Gauss-Newton step is -log_focal. Steps
    # are clamped to 0.1. From 0.25: 0.15, 0.05, 0.
    true = cameras_on_a_path(2)
    observations = observe(rng, true, [(0, 1)], torch.zeros(2, 16))
    unsure = replace(observations, confidence=torch.zeros_like(observations.confidence))
    for iterations, expected in ((1, 0.15), (2, 0.05), (3, 0.0)):
        *_, found = adjust_bundle(
            unsure, true[None], free(2, focal=True), GRID,
            log_focal=torch.tensor([0.25]), iterations=iterations,
        )  # fmt: skip
        assert found.item() == pytest.approx(expected, abs=1e-6)


def test_a_focal_length_moves_as_far_as_its_prior_lets_it(rng):
    true = cameras_on_a_path(4)
    observations = observe(rng, true, [(0, 1), (1, 2), (2, 3), (0, 2), (1, 3)], torch.zeros(4, 16))
    taken = torch.tensor([1.05, 1.05, 1.0])
    wrong = replace(
        observations, points=observations.points * taken, rays=observations.rays * taken[:2]
    )

    def found(deviation: float) -> float:
        settings = SolveSettings(torch.ones(1, 4), True, BundleNoise(focal=deviation))
        *_, log_focal = adjust_bundle(wrong, true[None], settings, GRID, iterations=20)
        return log_focal.item()

    assert abs(found(1e-4)) < 0.002
    assert found(1.0) == pytest.approx(torch.tensor(1.05).log().item(), abs=0.015)


def test_a_step_is_damped_by_a_ten_thousandth_of_the_twists_diagonal_by_hand():
    # Two unknowns that the data ties to nothing else: one camera's first number with hessian 4
    # and gradient 2, the focal length with 3 and -6; all others have hessian 1 and no gradient.
    hessian = torch.zeros(1, 2, 2, 7, 7)
    hessian[0, range(2), range(2)] = torch.eye(7)
    hessian[0, 1, 1, 0, 0] = 4
    gradient = torch.zeros(1, 2, 7)
    gradient[0, 1, 0] = 2
    equations = NormalEquations(
        hessian, gradient, torch.tensor([3.0]), torch.tensor([-6.0]), torch.zeros(1, 2, 7)
    )
    step, focal = bundle._solve(equations, focal_is_free=True)
    # Damping: 1e-4 of the mean of the twists' diagonal, (11 x 1 + 4) / 12 = 1.25.
    assert step[0, 1, 0].item() == pytest.approx(-2 / (4 + 1.25e-4), rel=1e-6)
    assert focal.item() == pytest.approx(2)
    _, focal = bundle._solve(equations, focal_is_free=False)
    assert focal.item() == 0
