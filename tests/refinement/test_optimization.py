from dataclasses import replace
from typing import Any

import pytest
import torch

from instok3d.refinement.optimization import Progress, refine_gaussians, typical_distance
from instok3d.refinement.settings import LearningRates, RefinementSettings
from instok3d.render import render
from instok3d.types import Cameras, Gaussians
from made_scene import HEIGHT, WIDTH, made_tokens

PLANES: dict[str, Any] = {"near": 0.05, "far": 100.0}
QUICK = RefinementSettings(steps=40, coarse_side=12)


@pytest.fixture(scope="module")
def truth() -> tuple[Gaussians, Cameras, torch.Tensor]:
    tokens = made_tokens(num_views=4)
    gaussians, cameras = tokens.gaussians.scene(0), tokens.geometry.cameras.scene(0)
    return gaussians, cameras, render(gaussians, cameras, HEIGHT, WIDTH, **PLANES).colors


def blurred(gaussians: Gaussians) -> Gaussians:
    """Wider, paler, and all grey."""
    return replace(
        gaussians,
        scales=1.4 * gaussians.scales,
        opacities=0.7 * gaussians.opacities,
        sh=0.3 * gaussians.sh,
    )


def test_blurred_gaussians_find_back_to_the_photos_and_keep_their_anchors(truth):
    gaussians, cameras, photos = truth
    start = blurred(gaussians)
    result = refine_gaussians(start, cameras, photos, QUICK, **PLANES)
    assert result.steps == 40
    assert result.psnr_after > result.psnr_before + 8
    assert torch.equal(result.gaussians.anchor_index, start.anchor_index)
    error = (render(result.gaussians, cameras, HEIGHT, WIDTH, **PLANES).colors - photos).square()
    assert abs(-10 * error.mean().log10() - result.psnr_after) < 1.0


def test_no_step_gives_the_same_gaussians(truth):
    gaussians, cameras, photos = truth
    result = refine_gaussians(gaussians, cameras, photos, replace(QUICK, steps=0), **PLANES)
    assert result.gaussians is gaussians
    assert result.steps == 0
    assert result.psnr_before == result.psnr_after == 100.0


def test_no_gaussian_is_refined_to_no_gaussian(truth):
    gaussians, cameras, photos = truth
    none = gaussians.rows(slice(0, 0))
    result = refine_gaussians(none, cameras, photos, QUICK, **PLANES)
    assert len(result.gaussians.means) == 0
    assert result.steps == 0
    assert typical_distance(none, cameras) == 1.0


def test_same_seed_same_bits_other_seed_other_order_of_views(truth):
    gaussians, cameras, photos = truth
    few = replace(QUICK, steps=4, views_per_step=1)
    once, again, other = (
        refine_gaussians(blurred(gaussians), cameras, photos, settings, **PLANES).gaussians
        for settings in (few, few, replace(few, seed=5))
    )
    assert torch.equal(once.means, again.means)
    assert torch.equal(once.sh, again.sh)
    assert not torch.equal(once.sh, other.sh)


def test_masked_pixels_change_nothing(truth):
    gaussians, cameras, photos = truth
    known = torch.ones(4, HEIGHT, WIDTH, dtype=torch.bool)
    known[:, :, WIDTH // 2 :] = False
    spoilt = torch.where(known[:, None], photos, torch.rand_like(photos))
    few = replace(QUICK, steps=8)
    # At half the size too: columns are halved in pairs, and the border is even.
    with_truth = refine_gaussians(blurred(gaussians), cameras, photos, few, known=known, **PLANES)
    with_noise = refine_gaussians(blurred(gaussians), cameras, spoilt, few, known=known, **PLANES)
    for name, value in vars(with_truth.gaussians).items():
        assert torch.equal(value, getattr(with_noise.gaussians, name)), name


def test_light_that_differs_between_photos_stays_out_of_the_colours(truth):
    gaussians, cameras, photos = truth
    gains = torch.tensor([1.25, 0.8, 1.25, 0.8]).view(4, 1, 1, 1)
    fitted = refine_gaussians(gaussians, cameras, gains * photos, QUICK, **PLANES)
    plain = refine_gaussians(
        gaussians, cameras, gains * photos, replace(QUICK, exposure=False), **PLANES
    )

    def error(result) -> float:
        renders = render(result.gaussians, cameras, HEIGHT, WIDTH, **PLANES).colors
        return float((renders - photos).abs().mean())

    assert error(fitted) < 0.6 * error(plain)
    assert fitted.psnr_after > plain.psnr_after + 3


def test_a_pull_keeps_centres_where_they_were(truth):
    gaussians, cameras, photos = truth
    turned = photos.flip(-1)
    moved = [
        (
            refine_gaussians(
                gaussians, cameras, turned, replace(QUICK, mean_pull=pull), **PLANES
            ).gaussians.means
            - gaussians.means
        ).norm()
        for pull in (0.0, 1000.0)
    ]
    assert moved[1] < 0.7 * moved[0]


def test_progress_is_told_and_a_stop_keeps_what_is_there(truth):
    gaussians, cameras, photos = truth
    told: list[Progress] = []
    left = iter([False] * 13)
    result = refine_gaussians(
        blurred(gaussians), cameras, photos, QUICK, progress=told.append,
        stop=lambda: next(left, True), **PLANES,
    )  # fmt: skip
    assert [at.step for at in told] == [10]
    assert told[0].steps == 40
    assert result.steps == 13
    assert result.psnr_after > result.psnr_before


def test_splitting_adds_gaussians_of_the_same_anchors(truth):
    gaussians, cameras, photos = truth
    settings = replace(QUICK, steps=30, split_share=0.25)
    result = refine_gaussians(blurred(gaussians), cameras, photos, settings, **PLANES)
    count = len(gaussians.means)
    assert len(result.gaussians.means) == count + count // 4
    assert set(result.gaussians.anchor_index.tolist()) == set(gaussians.anchor_index.tolist())
    assert result.psnr_after > result.psnr_before + 5


def test_a_scene_in_other_units_is_refined_alike(truth):
    """Steps and the pull of the centres are relative to the size of the scene."""
    gaussians, cameras, photos = truth
    start, unit = blurred(gaussians), 4.0
    far_off = cameras.cam_from_world.clone()
    far_off[:, :3, 3] *= unit
    settings = replace(QUICK, steps=6, mean_pull=50.0)
    plain = refine_gaussians(start, cameras, photos, settings, **PLANES).gaussians
    scaled = refine_gaussians(
        replace(start, means=unit * start.means, scales=unit * start.scales),
        replace(cameras, cam_from_world=far_off), photos, settings, near=0.2, far=400.0,
    ).gaussians  # fmt: skip
    torch.testing.assert_close(scaled.means / unit, plain.means, atol=2e-4, rtol=0)
    torch.testing.assert_close(scaled.scales / unit, plain.scales, atol=1e-3, rtol=1e-2)


def test_a_mask_that_hides_nothing_changes_nothing(truth):
    gaussians, cameras, photos = truth
    known = torch.ones(4, HEIGHT, WIDTH, dtype=torch.bool)
    settings = replace(QUICK, steps=6, mean_pull=1000.0)
    plain = refine_gaussians(blurred(gaussians), cameras, photos, settings, **PLANES)
    masked = refine_gaussians(blurred(gaussians), cameras, photos, settings, known=known, **PLANES)
    torch.testing.assert_close(masked.gaussians.means, plain.gaussians.means, atol=1e-5, rtol=0)
    assert masked.psnr_after == pytest.approx(plain.psnr_after, abs=0.05)


def test_psnr_is_of_pictures_that_can_be_shown(truth):
    """What is brighter than white is white."""
    gaussians, cameras, _ = truth
    glaring = replace(gaussians, sh=10 * gaussians.sh.abs())
    photos = render(glaring, cameras, HEIGHT, WIDTH, **PLANES).colors
    assert float(photos.max()) > 1.5
    result = refine_gaussians(
        glaring, cameras, photos.clamp(0, 1), replace(QUICK, steps=0), **PLANES
    )
    assert result.psnr_before == 100.0


def test_halves_are_pulled_to_where_they_were_put(truth):
    gaussians, cameras, photos = truth
    quick_to_move = LearningRates(means=0.01)
    settings = replace(QUICK, split_share=0.25, mean_pull=1e6, rates=quick_to_move)
    result = refine_gaussians(blurred(gaussians), cameras, photos, settings, **PLANES)
    distances = torch.cdist(result.gaussians.means, gaussians.means).min(dim=1).values
    # Twenty halves, a tenth to half a unit away from the ten that were split.
    assert int((distances > 0.05).sum()) >= 16
