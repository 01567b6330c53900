"""Depth that is brought to known points."""

import pytest
import torch

from instok3d.sfm.sparse_depth import LEAST_POINTS, KnownPoints, fit_depth


def points(count: int, rng: torch.Generator) -> torch.Tensor:
    return 31.9 * torch.rand(count, 2, generator=rng)


def at(depths: torch.Tensor, pixels: torch.Tensor) -> torch.Tensor:
    x, y = pixels.long().T
    return depths[y, x]


def test_each_view_gets_its_own_scale(rng: torch.Generator):
    depths = 1 + torch.rand(2, 32, 32, generator=rng)
    places = [points(60, rng), points(60, rng)]
    known = [
        KnownPoints(each, scale * at(depth, each))
        for each, scale, depth in zip(places, (2, 3), depths, strict=True)
    ]
    fitted = fit_depth(depths, known)
    torch.testing.assert_close(fitted, depths * torch.tensor([2.0, 3.0])[:, None, None])


def test_a_smooth_error_goes_away_between_the_points_too(rng: torch.Generator):
    x = torch.linspace(-1, 1, 32)
    true = (2 + x[:, None] ** 2) * torch.ones(32, 32)
    wrong = true * (0.3 * torch.sin(2 * x)).exp()
    places = points(150, rng)
    known = at(true, places)
    known[:15] *= 4  # a tenth are wrong
    fitted = fit_depth(wrong[None], [KnownPoints(places, known)])[0]

    def error(depths: torch.Tensor) -> float:
        ratio = (depths / true).log()
        return float((ratio - ratio.median()).abs().mean())

    assert error(wrong) > 0.15
    assert error(fitted) < 0.03
    assert float((fitted / true).log().median().abs()) < 0.02


def test_a_view_with_few_points_takes_the_scale_of_the_others(rng: torch.Generator):
    depths = torch.ones(2, 32, 32)
    known = [
        KnownPoints(points(count, rng), torch.full((count,), depth))
        for count, depth in ((60, 5.0), (LEAST_POINTS - 1, 9.0))
    ]
    fitted = fit_depth(depths, known)
    torch.testing.assert_close(fitted, torch.full_like(fitted, 5.0))


def test_points_outside_of_the_image_are_not_used(rng: torch.Generator):
    places = torch.cat([points(60, rng), torch.tensor([[-0.1, 3.0], [32.0, 3.0]] * 60)])
    known = torch.cat([torch.full((60,), 2.0), torch.full((120,), 7.0)])
    fitted = fit_depth(torch.ones(1, 32, 32), [KnownPoints(places, known)])
    torch.testing.assert_close(fitted, torch.full_like(fitted, 2.0))


def test_without_points_it_is_refused():
    with pytest.raises(ValueError, match=r"no photo shows 20 points .* take more photos"):
        fit_depth(torch.ones(1, 8, 8), [KnownPoints(torch.empty(0, 2), torch.empty(0))])
