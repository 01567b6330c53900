import numpy as np
import torch

from instok3d.data.photometric import photometric_change


def change(seed: int, context: torch.Tensor, target: torch.Tensor):
    return photometric_change(np.random.default_rng(seed), context, target)


def test_the_same_draw_gives_the_same_light_and_another_gives_another(rng):
    images = torch.rand(2, 3, 8, 8, generator=rng)
    first, again, other = (change(seed, images, images) for seed in (1, 1, 2))
    assert torch.equal(first[0], again[0])
    assert torch.equal(first[1], again[1])
    assert not torch.allclose(first[1], other[1], atol=1e-3)


def test_targets_get_the_light_of_the_contexts_without_their_noise():
    # A grey room: noise averages out over 64 x 64 pixels (0.02 / 64 = 3e-4 at most), the light
    # stays.
    grey = torch.full((2, 3, 64, 64), 0.4)
    for seed in range(10):
        context, target = change(seed, grey, grey)
        assert torch.equal(target[0], target[1])
        assert float(target.flatten(2).std(dim=-1).max()) < 1e-6
        torch.testing.assert_close(context.mean((2, 3)), target.mean((2, 3)), atol=2e-3, rtol=0)
        assert float(context.flatten(2).std(dim=-1).max()) < 0.025


def test_light_is_one_affine_map_of_each_channel(rng):
    # Mid-range colours are not cut, so the map of each channel is a line through any two pixels.
    images = 0.45 + 0.1 * torch.rand(1, 3, 8, 8, generator=rng)
    _, changed = change(3, images, images)
    assert 0 < float(changed.min()) <= float(changed.max()) < 1
    for before, after in zip(images[0].flatten(1), changed[0].flatten(1), strict=True):
        slope = (after[1] - after[0]) / (before[1] - before[0])
        torch.testing.assert_close(
            after, after[0] + slope * (before - before[0]), atol=1e-4, rtol=0
        )


def test_results_stay_colours(rng):
    images = torch.randint(2, (2, 3, 8, 8), generator=rng).float()
    for seed in range(10):
        for result in change(seed, images, images):
            assert 0 <= float(result.min()) <= float(result.max()) <= 1


def test_a_scene_without_targets_is_no_error(rng):
    images = torch.rand(1, 3, 4, 4, generator=rng)
    assert change(0, images, images[:0])[1].shape == (0, 3, 4, 4)
