from dataclasses import replace
from typing import get_args

import pytest
import torch

from instok3d.cli import evaluate as command
from instok3d.data.photo_effects import luma
from instok3d.data.sample import Sample
from instok3d.evaluation.disturbances import DISTURBANCES, disturbed
from instok3d.evaluation.protocols import ProtocolScene
from instok3d.geometry.cameras import unproject
from instok3d.types import Views

PHOTOS = [name for name in DISTURBANCES if not name.startswith("focal")]


def scene_of(sample: Sample, name: str = "2000000") -> ProtocolScene:
    return ProtocolScene(name, None, (sample,))


def of_colour(sample: Sample, colour: float) -> Sample:
    """The sample with photos of one grey."""
    images = torch.full((1, 4, 3, 64, 64), colour)  # four photos: more than the sample has
    return replace(sample, context=Views(images=images))


def photos_of(sample: Sample, name: str) -> torch.Tensor:
    return disturbed(scene_of(sample), name).samples[0].context.images[0]


def test_the_command_offers_all_disturbances():
    assert get_args(command.Disturbance) == DISTURBANCES


@pytest.mark.parametrize("name", PHOTOS)
def test_photos_change_in_a_fixed_way_and_everything_else_stays(flat_sample, name):
    (first,), (again,), (other,) = (
        disturbed(scene_of(flat_sample, scene), name).samples for scene in ("1", "1", "2")
    )
    assert not torch.equal(first.context.images, flat_sample.context.images)
    assert 0 <= float(first.context.images.min()) <= float(first.context.images.max()) <= 1
    assert torch.equal(first.context.images, again.context.images)
    drawn = name in ("noise8", "exposure20", "hard")
    assert torch.equal(first.context.images, other.context.images) or drawn
    assert first.target is flat_sample.target
    assert first.context.depths is flat_sample.context.depths
    assert first.context.intrinsics is flat_sample.context.intrinsics


def test_exposures_differ_by_a_fifth_and_their_mean_stays(flat_sample):
    photos = photos_of(of_colour(flat_sample, 0.5), "exposure20")
    means = photos.mean(dim=(1, 2, 3))
    torch.testing.assert_close(means.sort().values, torch.tensor([0.4, 0.4, 0.6, 0.6]))
    torch.testing.assert_close(means[:2], means[2:])
    assert (means[0] - means[1]).abs() > 0.1


def test_noise_has_eight_levels_and_no_mean(flat_sample):
    photos = photos_of(of_colour(flat_sample, 0.5), "noise8")
    assert float(photos.std()) == pytest.approx(8 / 255, rel=0.02)
    assert float(photos.mean()) == pytest.approx(0.5, abs=1e-3)


def test_overexposed_photos_are_cut_at_white(flat_sample):
    torch.testing.assert_close(
        photos_of(of_colour(flat_sample, 0.5), "overexposed"), torch.full((4, 3, 64, 64), 0.8)
    )
    assert (photos_of(of_colour(flat_sample, 0.7), "overexposed") == 1).all()


def test_grey_photos_keep_their_luma(flat_sample):
    photos = photos_of(flat_sample, "grey")
    torch.testing.assert_close(photos[:, :1].expand_as(photos), photos)
    torch.testing.assert_close(luma(photos), luma(flat_sample.context.images[0]))


def test_jpeg_rounds_within_its_blocks_and_keeps_a_plain_photo(flat_sample):
    plain = photos_of(of_colour(flat_sample, 128 / 255), "jpeg30")
    torch.testing.assert_close(plain, torch.full_like(plain, 128 / 255), atol=1.1 / 255, rtol=0)
    # An edge inside a block spreads over it and no further.
    edge = torch.zeros(1, 4, 3, 64, 64)
    edge[..., 20:] = 1.0  # blocks of colour are 16 wide: this one ends at 32
    photos = photos_of(replace(flat_sample, context=Views(images=edge)), "jpeg30")
    wrong = (photos - edge[0]).abs().amax(dim=(0, 1, 2))
    assert float(wrong[16:32].max()) > 0.01
    assert float(wrong[:16].max()) < 0.01 > float(wrong[32:].max())


def test_hard_photos_are_exposed_apart_blurred_and_noisy(flat_sample):
    plain = photos_of(of_colour(flat_sample, 0.5), "hard")
    means = plain.mean(dim=(1, 2, 3))
    assert float((means[0] - means[1]).abs()) == pytest.approx(0.2, abs=0.06)
    assert float(plain.std(dim=(2, 3)).min()) > 1 / 255  # JPEG takes most of the noise
    # A black dot on white, which a line of 1.5 pixels at a height of 128 spreads at 256.
    dot = torch.full((1, 1, 3, 256, 256), 0.7)
    dot[..., 128, 128] = 0.0
    photo = photos_of(replace(flat_sample, context=Views(images=dot)), "hard")[0]
    assert float(photo[:, 128, 128].min()) > 0.2


@pytest.mark.parametrize("factor", [1.33, 2])
def test_a_longer_lens_sees_the_same_points_in_contexts_and_targets(flat_sample, factor):
    (zoomed,) = disturbed(scene_of(flat_sample), f"focal{factor}").samples
    for part, ids in (("context", "context_instances"), ("target", "target_instances")):
        before, after = getattr(flat_sample, part), getattr(zoomed, part)
        assert after.images.shape == before.images.shape
        ratio = after.intrinsics[..., [0, 1], [0, 1]] / before.intrinsics[..., [0, 1], [0, 1]]
        torch.testing.assert_close(ratio, torch.full_like(ratio, factor))
        # Depth is the nearest pixel's: its place, and so the point, is off by up to half a pixel.
        size = before.images.shape[-1]
        places = ((torch.arange(size) + 0.5 - size / 2) / factor + size / 2).floor().long()
        seen = unproject(before.depths, before.intrinsics)[..., places[:, None], places, :]
        points = unproject(after.depths, after.intrinsics)
        tolerance = 0.51 * before.depths.max() / before.intrinsics[0, 0, 0, 0]
        assert float((points - seen).abs().max()) < tolerance
        old_ids, new_ids = getattr(flat_sample, ids), getattr(zoomed, ids)
        assert torch.equal(new_ids, old_ids[..., places[:, None], places])


def test_twice_the_focal_length_shows_the_inner_quarter(flat_sample):
    size = flat_sample.context.images.shape[-1]
    ramp = (torch.arange(size) + 0.5).expand(1, 2, 3, size, size) / size
    (zoomed,) = disturbed(
        scene_of(replace(flat_sample, context=replace(flat_sample.context, images=ramp))), "focal2"
    ).samples
    expected = 0.25 + (torch.arange(size) + 0.5) / (2 * size)
    torch.testing.assert_close(zoomed.context.images, expected.expand(1, 2, 3, size, size))


def test_no_sample_and_no_target_are_no_errors_and_other_names_are(flat_sample):
    assert disturbed(ProtocolScene("1", None, ()), "hard").samples == ()
    for name in DISTURBANCES:
        bare = replace(flat_sample, target=flat_sample.target.map(lambda t: t[:, :0]),
                       target_instances=flat_sample.target_instances[:, :0])  # fmt: skip
        assert disturbed(scene_of(bare), name).samples[0].target.images.shape[1] == 0
    with pytest.raises(ValueError, match=r"must be one of jpeg30, .*, got 'rain'"):
        disturbed(scene_of(flat_sample), "rain")
