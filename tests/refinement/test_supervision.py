from itertools import islice

import pytest
import torch

from instok3d.refinement.exposure import Exposure
from instok3d.refinement.supervision import Supervision, level_of_step, pyramid, turns
from instok3d.types import Cameras


def cameras(count: int) -> Cameras:
    intrinsics = torch.tensor([[8.0, 0, 4], [0, 8, 2], [0, 0, 1]])
    return Cameras(torch.eye(4).repeat(count, 1, 1), intrinsics.repeat(count, 1, 1))


def test_halving_takes_means_and_halves_the_intrinsics():
    photos = torch.arange(8.0).view(1, 1, 2, 4).expand(1, 3, 2, 4)
    half = Supervision.of(photos, cameras(1)).halved()
    torch.testing.assert_close(half.photos[0, 0], torch.tensor([[2.5, 4.5]]))
    expected = torch.tensor([[4.0, 0, 2], [0, 4, 1], [0, 0, 1]])
    torch.testing.assert_close(half.cameras.intrinsics[0], expected)


def test_masked_pixels_are_not_in_the_mean_of_a_halved_photo():
    photos = torch.tensor([[1.0, 100.0], [3.0, 100.0]]).expand(1, 3, 2, 2)
    known = torch.tensor([[[True, False], [True, False]]])
    half = Supervision.of(photos, cameras(1), known).halved()
    torch.testing.assert_close(half.photos, torch.full((1, 3, 1, 1), 2.0))
    torch.testing.assert_close(half.weights, torch.full((1, 1, 1, 1), 0.5))


def test_the_pyramid_ends_with_the_photos_and_begins_with_the_coarse_side():
    photos = torch.rand(2, 3, 64, 48)
    levels = pyramid(Supervision.of(photos, cameras(2)), coarse_side=16)
    assert [tuple(level.photos.shape[-2:]) for level in levels] == [(16, 12), (32, 24), (64, 48)]
    assert levels[-1].photos is photos
    assert len(pyramid(Supervision.of(photos, cameras(2)), coarse_side=33)) == 1


def test_coarse_levels_share_the_first_steps():
    levels = [level_of_step(step, 10, 3, 0.4) for step in range(10)]
    assert levels == [0, 0, 1, 1, 2, 2, 2, 2, 2, 2]
    assert [level_of_step(step, 3, 1, 0.4) for step in range(3)] == [0, 0, 0]
    assert level_of_step(0, 10, 3, 0.0) == 2


def test_every_view_has_its_turn_before_one_has_its_second():
    seen = [view for views in islice(turns(5, 2, seed=1), 5) for view in views]
    assert sorted(seen) == sorted(2 * list(range(5)))
    assert sorted(seen[:4]) == sorted(set(seen[:4]))
    assert list(islice(turns(2, 3, seed=0), 2)) == [[0, 1], [0, 1]]
    assert list(islice(turns(5, 2, seed=1), 9)) == list(islice(turns(5, 2, seed=1), 9))
    assert all(len(set(views)) == 3 for views in islice(turns(4, 3, seed=2), 20))


def test_sizes_that_disagree_and_photos_without_pixels_are_refused():
    photos = torch.rand(2, 3, 4, 4)
    with pytest.raises(ValueError, match="2 photos need as many cameras"):
        Supervision.of(photos, cameras(3))
    with pytest.raises(ValueError, match="masks"):
        Supervision.of(photos, cameras(2), torch.ones(2, 4, 5, dtype=torch.bool))
    with pytest.raises(ValueError, match="nothing to refine on"):
        Supervision.of(photos, cameras(2), torch.zeros(2, 4, 4, dtype=torch.bool))


def test_exposure_holds_the_mean_and_finds_the_difference():
    torch.manual_seed(0)
    scene = torch.rand(1, 3, 6, 6)
    photos = torch.cat([scene * 1.2, scene / 1.2])
    exposure = Exposure(2, rate=2e-2, device=torch.device("cpu"))
    for _ in range(100):
        renders = exposure.applied(scene.expand(2, 3, 6, 6), [0, 1])
        (renders - photos).abs().mean().backward()
        exposure.step()
    gains = exposure.log_gains.detach().exp()
    torch.testing.assert_close(gains[0] / gains[1], torch.full((3, 1, 1), 1.44), atol=0.1, rtol=0)
    for value in (exposure.log_gains, exposure.offsets):
        assert value.detach().mean(dim=0).abs().max() < 1e-6


def test_exposure_finds_offsets():
    scene = torch.full((2, 3, 4, 4), 0.5) * torch.linspace(0.5, 1.5, 16).view(4, 4)
    photos = scene + torch.tensor([0.1, -0.1]).view(2, 1, 1, 1)
    exposure = Exposure(2, rate=1e-2, device=torch.device("cpu"))
    for _ in range(200):
        (exposure.applied(scene, [0, 1]) - photos).square().mean().backward()
        exposure.step()
    difference = (exposure.offsets[0] - exposure.offsets[1]).detach()
    torch.testing.assert_close(difference, torch.full((3, 1, 1), 0.2), atol=0.03, rtol=0)
