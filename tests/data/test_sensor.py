from dataclasses import replace

import numpy as np
import pytest
import torch

from fake_rooms import FakeRooms
from instok3d.data.batches import BatchConfig, SceneBatches
from instok3d.data.sensor import SensorConfig, balanced, sensor_change
from instok3d.training.config import PRESETS

OFF = SensorConfig(
    strength=1.0, probability=1.0, darkening=0.0, highlights=0.0, contrast=0.0, saturation=0.0,
    exposure=0.0, white_balance=0.0, vignetting=0.0, distortion_px=0.0, blur_px=0.0,
    dark_noise=0.0, bright_noise=0.0, worst_jpeg=95,
)  # fmt: skip
"""A sensor that does nothing but write JPEG of quality 95."""
FULL = SensorConfig(strength=1.0, probability=1.0)


def grey(views: int, value: float = 0.5) -> torch.Tensor:
    return torch.full((views, 3, 48, 48), value)


def change(config: SensorConfig, context: torch.Tensor, target: torch.Tensor, seed: int = 0):
    return sensor_change(np.random.default_rng(seed), config, context, target)


def batch(step: int = 0, **settings):
    config = BatchConfig(2, mirror=True, **settings)
    return SceneBatches(FakeRooms(3, size=32), range(3), config, seed=0).batch(step)


def test_without_strength_nothing_is_drawn_and_nothing_changes(rng):
    drawn = np.random.default_rng(0)
    photos = torch.rand(2, 3, 8, 8, generator=rng)
    context, target = sensor_change(drawn, SensorConfig(), photos, photos)
    assert context is photos is target
    assert drawn.random() == np.random.default_rng(0).random()
    for step in range(4):
        plain, off = batch(step), batch(step, sensor=replace(FULL, strength=0.0))
        assert plain.names == off.names
        assert torch.equal(plain.context.images, off.context.images)


def test_presets_train_without_a_sensor_and_learn_matches_without_distortion():
    for name, preset in PRESETS.items():
        assert preset.batches.sensor.strength == 0, name
    for name in ("nano-geometry", "nano-refinement"):
        assert PRESETS[name].batches.sensor.distortion_px == 0


def test_a_sensor_that_is_off_in_all_but_name_writes_jpeg_alone():
    context, target = change(OFF, grey(2), grey(1, 0.3))
    torch.testing.assert_close(context, grey(2), atol=1 / 255, rtol=0)
    torch.testing.assert_close(target, grey(1, 0.3))


@pytest.mark.parametrize("views", [2, 3, 8])
def test_exposures_reach_their_bound_and_are_one_in_the_mean(views):
    config = replace(OFF, exposure=0.4)
    most = 0.0
    for seed in range(20):
        context, target = change(config, grey(views), grey(1), seed)
        gains = context.mean(dim=(1, 2, 3)) / 0.5
        assert float(gains.mean()) == pytest.approx(1.0, abs=0.01)
        assert 0.59 < float(gains.min()) <= float(gains.max()) < 1.41
        most = max(most, float((gains - 1).abs().max()))
        assert torch.equal(target, grey(1))
    assert most > 0.25


def test_white_balance_differs_between_views_and_colours():
    context, _ = change(replace(OFF, white_balance=0.1), grey(2), grey(0))
    means = context.mean(dim=(2, 3))
    torch.testing.assert_close(means.mean(dim=0), torch.full((3,), 0.5), atol=0.005, rtol=0)
    assert float(means.std(dim=0).min()) > 0 < float(means.std(dim=1).min())


def test_the_look_is_one_for_contexts_and_targets_and_darkens(rng):
    photos = torch.rand(2, 3, 16, 16, generator=rng)
    look = replace(OFF, darkening=1.1, contrast=0.2, saturation=0.4)
    context, target = change(look, photos, photos)
    # Of noise JPEG of quality 95 loses the colours alone.
    torch.testing.assert_close(
        context.mean(dim=(0, 2, 3)), target.mean(dim=(0, 2, 3)), atol=0.02, rtol=0
    )
    assert not torch.allclose(target, photos, atol=0.02)
    assert all(
        float(change(replace(OFF, darkening=1.1), grey(1), grey(1), seed)[1].max()) < 0.5
        for seed in range(5)
    )


def test_highlights_are_cut_in_contexts_and_targets():
    ramp = torch.linspace(0, 1, 48).expand(1, 3, 48, 48)
    looks = [change(replace(OFF, highlights=0.25), ramp, ramp, seed) for seed in range(10)]
    white = [int((target[0, 0, 0] == 1).sum()) for _, target in looks]
    assert 6 < max(white) <= 13  # up to a quarter of 48
    assert min(white) < 6
    for context, target in looks:
        torch.testing.assert_close(context, target, atol=3 / 255, rtol=0)


@pytest.mark.parametrize(
    "setting",
    [{"blur_px": 8.0}, {"vignetting": 0.4}, {"distortion_px": 4.0}, {"bright_noise": 0.1}],
)
def test_targets_know_nothing_of_lens_and_noise(rng, setting):
    photos = torch.rand(8, 1, 48, 48, generator=rng).expand(8, 3, 48, 48)
    plain, _ = change(OFF, photos, photos)
    context, target = change(replace(OFF, **setting), photos, photos)
    assert float((context - plain).abs().mean()) > 0.005
    assert torch.equal(target, photos)


def test_distortion_stays_within_a_pixel_at_a_height_of_128():
    # A white line through the middle row at the right border moves by less than one pixel.
    photos = torch.zeros(1, 3, 128, 128)
    photos[..., :, 120] = 1.0
    for seed in range(10):
        context, _ = change(replace(OFF, distortion_px=1.0), photos, photos[:0], seed)
        rows = context[0].mean(dim=0)
        place = (rows * torch.arange(128)).sum(dim=1) / rows.sum(dim=1)
        assert float((place - 120).abs().max()) < 1.2  # JPEG rings a little


def test_the_same_seed_gives_the_same_photos_and_other_data_stays():
    sensor = replace(FULL, probability=0.5)
    changed = 0
    for step in range(6):
        first, again, plain = batch(step, sensor=sensor), batch(step, sensor=sensor), batch(step)
        assert torch.equal(first.context.images, again.context.images)
        assert 0 <= float(first.context.images.min()) <= float(first.context.images.max()) <= 1
        changed += int((first.context.images != plain.context.images).flatten(1).any(1).sum())
    assert 2 < changed < 12
    # Matches are supervised by cameras and depth, which belong to the same frames as before.
    one = BatchConfig(1, sensor=FULL)
    with_sensor, without = (
        SceneBatches(FakeRooms(1, size=32), [0], config, seed=0).batch(0)
        for config in (one, replace(one, sensor=SensorConfig()))
    )
    for name in ("depths", "cam_from_world", "intrinsics"):
        assert torch.equal(getattr(with_sensor.context, name), getattr(without.context, name)), name
    assert torch.equal(with_sensor.context_instances, without.context_instances)


def test_balanced_numbers_by_law():
    rng = np.random.default_rng(0)
    for views in (1, 2, 5, 16):
        numbers = balanced(rng, views, 3)
        np.testing.assert_allclose(numbers.mean(axis=0), 0, atol=1e-12)
        assert np.abs(numbers).max() <= 1
    assert not balanced(rng, 1, 3).any()


def test_no_view_is_no_error_and_nonsense_is_refused():
    context, target = change(FULL, grey(1), grey(0))
    assert (len(context), len(target)) == (1, 0)
    with pytest.raises(ValueError, match=r"sensor\.strength must lie within 0 and 1, got 2"):
        SensorConfig(strength=2.0)
    with pytest.raises(ValueError, match=r"sensor\.blur_px must be 0 or more, got -1"):
        SensorConfig(blur_px=-1.0)
    with pytest.raises(ValueError, match=r"sensor\.worst_jpeg must lie within 1 and 95, got 0"):
        SensorConfig(worst_jpeg=0)
