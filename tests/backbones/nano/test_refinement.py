"""Parallax says what depth should have been; the refinement starts as nothing and learns that."""

from dataclasses import replace

import pytest
import torch
from torch.nn import functional

from instok3d.backbones.nano.backbone import NanoBackbone, NanoConfig
from instok3d.backbones.nano.matching import Matches, cell_centers
from instok3d.backbones.nano.pair_matches import MatchedCells, PairMatches, PhotoViews
from instok3d.backbones.nano.refinement import gather_evidence, measure_parallax
from instok3d.geometry.cameras import intrinsics_from_field_of_view
from instok3d.types import Views

TINY = NanoConfig(width=64, layers=1, match_channels=16, refinement_layers=1)


def one_match(
    depth: float,
    ray: tuple[float, float],
    confidence: float = 1.0,
    precision: tuple[float, float] = (1.0, 1.0),
) -> MatchedCells:
    """A cell straight ahead at some depth, seen by the other camera along a ray."""
    point = torch.tensor([[[0.0, 0.0, depth]]])
    known = torch.tensor(precision).diag()[None, None]
    return MatchedCells(point, torch.tensor([[ray]]), point, torch.tensor([[confidence]]), known)


def stepped_aside(distance: float) -> torch.Tensor:
    motion = torch.eye(4)[None].clone()
    motion[0, 0, 3] = -distance
    return motion


def test_parallax_of_one_match_by_hand():
    # The other camera stands 0.5 to the right. At depth 2 the point is at x/z = -0.25 there, and
    # d(x/z) / d(log depth) = 0.25. The match lies at -0.20: 0.05 / 0.25 = 0.2 deeper in the log.
    residual, weight, unexplained = measure_parallax(
        one_match(2.0, (-0.2, 0.0), 0.8), stepped_aside(0.5)
    )
    torch.testing.assert_close(residual, torch.tensor([[0.2]]))
    torch.testing.assert_close(weight, torch.tensor([[0.8 * 0.25**2]]))
    torch.testing.assert_close(unexplained, torch.tensor([[0.0]]), atol=1e-6, rtol=0)


def test_a_match_that_is_known_across_the_parallax_alone_says_nothing_of_depth():
    sure = one_match(2.0, (-0.2, 0.0), precision=(100.0, 0.0))
    _, weight, _ = measure_parallax(sure, stepped_aside(0.5))
    torch.testing.assert_close(weight, torch.tensor([[100 * 0.25**2]]))
    blind = one_match(2.0, (-0.2, 0.0), precision=(0.0, 100.0))
    _, weight, _ = measure_parallax(blind, stepped_aside(0.5))
    assert weight.item() == 0


def test_what_lies_across_the_parallax_is_a_miss_and_no_depth():
    residual, _, unexplained = measure_parallax(one_match(2.0, (-0.25, 0.1)), stepped_aside(0.5))
    torch.testing.assert_close(residual, torch.tensor([[0.0]]), atol=1e-6, rtol=0)
    torch.testing.assert_close(unexplained, torch.tensor([[0.1]]))


def test_cameras_in_one_place_and_points_behind_say_nothing():
    _, weight, _ = measure_parallax(one_match(2.0, (0.1, 0.0)), torch.eye(4)[None])
    assert weight.item() == 0
    behind = torch.eye(4)[None].clone()
    behind[0, :3, 3] = torch.tensor([-0.5, 0, -3.0])
    residual, weight, unexplained = measure_parallax(one_match(2.0, (0.1, 0.0)), behind)
    assert weight.item() == 0
    assert residual.isfinite().all()
    assert unexplained.isfinite().all()


def same_place(rows: int, columns: int) -> Matches:
    """Every cell matched to its own place, known to a pixel."""
    centers = cell_centers(rows, columns, like=torch.zeros(1))
    count = len(centers)
    return Matches(
        centers, centers[None], torch.eye(2).expand(1, count, 2, 2), torch.ones(1, count)
    )


def test_evidence_of_three_views_is_a_weighted_mean_and_views_without_pairs_have_none():
    # Cells matched to their own places in views 0.5 and 1 to the side: the points seem infinitely
    # far. From depth 2, x/z = -0.25 and -0.5 must rise to 0: 1 in the log each, cut off at 1.
    depths = torch.full((1, 4, 8, 8), 2.0)
    intrinsics = intrinsics_from_field_of_view(torch.tensor(1.0), 8, 8).expand(1, 4, 3, 3)
    zero = torch.tensor([0])
    same = same_place(2, 2)
    pairs = [PairMatches(zero, zero + other, same, same) for other in (1, 2)]
    cameras = torch.stack([torch.eye(4)[None], stepped_aside(0.5), stepped_aside(1.0)], dim=1)
    cameras = torch.cat([cameras, torch.eye(4)[None, None]], dim=1)
    views = PhotoViews(torch.zeros(1, 4, 3, 8, 8), depths, intrinsics)
    evidence = gather_evidence(pairs, views, cameras)
    focal = float(intrinsics[0, 0, 0, 0])
    torch.testing.assert_close(evidence.residuals[0, :3], torch.ones(3, 4))
    torch.testing.assert_close(
        evidence.weights[0, 0], torch.full((4,), focal**2 * (0.25**2 + 0.5**2))
    )
    torch.testing.assert_close(evidence.weights[0, 2], torch.full((4,), focal**2 * 0.5**2))
    assert evidence.matched[0].tolist() == [[1.0] * 4] * 3 + [[0.0] * 4]
    assert evidence.weights[0, 3].count_nonzero() == 0


@pytest.mark.parametrize("views", [1, 3])
def test_a_new_refinement_changes_nothing(rng, views):
    torch.manual_seed(0)
    backbone = NanoBackbone(TINY).eval()
    photos = Views(torch.rand(2, views, 3, 32, 48, generator=rng))
    with torch.no_grad():
        refined = backbone(photos)
        backbone.refinement = None
        plain = backbone(photos)
    torch.testing.assert_close(refined.depths, plain.depths)
    torch.testing.assert_close(refined.pointmaps, plain.pointmaps)


def test_gradient_reaches_the_refinement_and_the_depth_that_it_corrects(rng):
    torch.manual_seed(0)
    backbone = NanoBackbone(TINY)
    assert backbone.refinement is not None
    torch.nn.init.normal_(backbone.refinement.correct.weight)
    views = Views(torch.rand(1, 2, 3, 32, 32, generator=rng))
    geometry = backbone(views)
    (geometry.depths.square().sum() + geometry.confidences.sum()).backward()
    moved = {name.split(".")[0] for name, p in backbone.named_parameters() if p.grad is not None}
    assert {"refinement", "to_coarse_depth", "to_fine_depth"} <= moved
    assert not moved & {"to_descriptor", "to_focal", "log_sharpness"}
    assert all(p.grad is not None for p in backbone.refinement.parameters())


def test_what_the_refinement_looks_at_is_not_differentiated(rng):
    torch.manual_seed(0)
    backbone = NanoBackbone(TINY)
    assert backbone.refinement is not None
    torch.nn.init.normal_(backbone.refinement.correct.weight, std=0.01)
    views = Views(torch.rand(1, 2, 3, 32, 32, generator=rng))
    raw = backbone.encode(views)
    intrinsics, matches = backbone.intrinsics(views, raw), backbone.find_matches(raw)
    refined = backbone.refine(raw, views, intrinsics, matches)
    backbone.refinement = None
    coarse = backbone.refine(raw, views, intrinsics, matches)
    assert not torch.equal(refined.log_depths, coarse.log_depths)
    (slope,) = torch.autograd.grad(refined.log_depths.sum(), raw.log_depths)
    assert torch.equal(slope, torch.ones_like(slope))


def test_without_a_network_depth_still_moves_with_the_cameras(rng):
    torch.manual_seed(0)
    backbone = NanoBackbone(NanoConfig(width=64, layers=1, match_channels=16, refinement_layers=0))
    views = Views(torch.rand(1, 2, 3, 64, 64, generator=rng))
    raw = backbone.encode(views)
    # Every cell is sure of its own place in the other view, which stands aside by nobody's
    # knowledge; the descriptors of an untrained network are sure of nothing.
    sure = torch.nn.functional.one_hot(torch.arange(256) % 16, 16).float()
    sure = torch.cat([sure, torch.nn.functional.one_hot(torch.arange(256) // 16, 16)], dim=-1)
    raw = replace(raw, descriptors=functional.normalize(sure, dim=-1).expand(1, 2, -1, -1))
    with torch.no_grad():
        backbone.log_sharpness.fill_(4.0)
    matches = backbone.find_matches(raw)
    assert matches[0].of_a.confidence.min() > 0.6
    refined = backbone.refine(raw, views, backbone.intrinsics(views, raw), matches)
    moved = refined.log_depths - raw.log_depths
    # Two views with one and the same picture: their depths come together.
    before = (raw.log_depths[0, 0] - raw.log_depths[0, 1]).abs().mean()
    after = (refined.log_depths[0, 0] - refined.log_depths[0, 1]).abs().mean()
    assert moved.abs().max() > 0
    assert after < before
    assert torch.equal(refined.log_confidences, raw.log_confidences)
