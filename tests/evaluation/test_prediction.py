from dataclasses import replace

import pytest
import torch

from flat_rooms import FlatRooms, in_another_world, oracle
from instok3d.data.batches import make_sample
from instok3d.data.sample import Sample, collate
from instok3d.data.view_sampling import FrameChoice
from instok3d.evaluation.image_quality import psnr
from instok3d.evaluation.instance_ap import average_precision, match_image
from instok3d.evaluation.prediction import predict
from instok3d.geometry.camera_alignment import TargetCameras
from instok3d.types import TokenGroups, Views

ROOMS = FlatRooms([0], ["easy"])


@pytest.mark.parametrize("mode", ["given", "intrinsics", "predicted"])
def test_a_model_that_knows_the_truth_is_nearly_perfect(flat_sample, mode):
    prediction = predict(oracle(flat_sample), flat_sample, mode)
    assert (
        float(psnr(prediction.images, flat_sample.target.images[0])) > 21.5
    )  # edges blur at this size
    matches = match_image(flat_sample.target_instances[0, 0].numpy(), prediction.masks[0])
    assert matches.num_instances == 3
    assert average_precision([matches]).ap50 == 1.0
    assert prediction.num_groups_used == 3


def test_each_mode_shows_what_it_says_and_no_more(flat_sample):
    seen: list[Views] = []

    def model(views: Views) -> TokenGroups:
        seen.append(views)
        return oracle(flat_sample)(views)

    for mode in ("predicted", "intrinsics", "given"):
        predict(model, flat_sample, mode)
    context = flat_sample.context
    bare, told, given = seen
    assert bare.cam_from_world is bare.depths is bare.intrinsics is None
    assert told.cam_from_world is told.depths is None
    assert torch.equal(told.intrinsics, context.intrinsics)
    assert torch.equal(given.depths, context.depths)
    assert all(torch.equal(views.images, context.images) for views in seen)


def test_another_guess_of_the_scale_changes_nothing(flat_sample):
    plain = predict(oracle(flat_sample), flat_sample, "predicted")
    scaled = predict(oracle(flat_sample, unit=1.7), flat_sample, "predicted")
    torch.testing.assert_close(scaled.images, plain.images, atol=5e-3, rtol=0)
    assert scaled.images_depth_scaled is not None
    torch.testing.assert_close(scaled.images_depth_scaled, plain.images, atol=5e-3, rtol=0)


def test_at_true_cameras_a_model_must_answer_in_their_unit(flat_sample):
    # Not midway, where no length would matter: frame 10 is 0.8 to the right of the first camera,
    # in a unit of 1.3 it should be 0.62.
    sample = make_sample(ROOMS, 0, FrameChoice((0, 15), (10,)))
    photos = sample.target.images[0]

    def quality(unit: float, target_cameras: TargetCameras) -> float:
        model = oracle(sample, unit=unit)
        prediction = predict(model, sample, "intrinsics", target_cameras=target_cameras)
        assert prediction.images_depth_scaled is None or target_cameras == "aligned"
        return float(psnr(prediction.images, photos))

    right = quality(1.0, "true")
    assert right == pytest.approx(quality(1.0, "aligned"), abs=0.05)
    assert right == pytest.approx(quality(1.3, "aligned"), abs=0.05)
    assert quality(1.3, "true") < right - 2


def test_true_target_cameras_are_rendered_as_they_are(flat_sample):
    prediction = predict(oracle(flat_sample), flat_sample, "intrinsics", target_cameras="true")
    assert torch.equal(prediction.cameras.cam_from_world, flat_sample.target.cam_from_world[0])
    assert torch.equal(prediction.cameras.intrinsics, flat_sample.target.intrinsics[0])


def test_the_world_of_the_truth_does_not_matter_for_photos(flat_sample):
    plain = predict(oracle(flat_sample), flat_sample, "predicted")
    moved = predict(oracle(flat_sample), in_another_world(flat_sample), "predicted")
    # Not pixel by pixel: the boards of the two contexts coincide, and rounding decides which of
    # two Gaussians at one depth is drawn first.
    assert (moved.images - plain.images).abs().mean() < 1e-3


def test_true_depth_never_enters_the_picture(flat_sample):
    # With depth made wrong by a factor of two, only the diagnostic that is scaled by it changes.
    # (The target is not midway, where no length would matter.)
    sample = make_sample(ROOMS, 0, FrameChoice((4, 12), (6,)))
    assert sample.context.depths is not None
    halved = replace(sample.context, depths=sample.context.depths / 2)
    plain = predict(oracle(sample), sample, "predicted")
    other = predict(oracle(sample), replace(sample, context=halved), "predicted")
    assert torch.equal(plain.images, other.images)
    assert plain.images_depth_scaled is not None
    assert other.images_depth_scaled is not None
    assert not torch.allclose(plain.images_depth_scaled, other.images_depth_scaled, atol=0.05)


def test_a_batch_of_two_scenes_is_refused(flat_sample: Sample):
    with pytest.raises(ValueError, match="one scene, got 2"):
        predict(oracle(flat_sample), collate([flat_sample, flat_sample]), "given")


@pytest.mark.parametrize("part", ["means", "sh", "opacities", "assignment", "depths", "cameras"])
def test_an_answer_that_is_no_number_is_an_error_that_names_the_sample(flat_sample, part):
    """A renderer leaves such a Gaussian out: the picture would look measured."""
    groups = oracle(flat_sample)(flat_sample.context)

    def spoiled(values: torch.Tensor) -> torch.Tensor:
        values = values.clone()
        values.view(-1)[3] = torch.nan
        return values

    if part == "assignment":
        groups = replace(groups, assignment=spoiled(groups.assignment))
    elif part in ("depths", "cameras"):
        geometry = groups.geometry
        cameras = replace(geometry.cameras, cam_from_world=spoiled(geometry.cameras.cam_from_world))
        changed = {"depths": spoiled(geometry.depths), "cameras": cameras}[part]
        groups = replace(groups, geometry=replace(geometry, **{part: changed}))
    else:
        gaussians = replace(groups.gaussians, **{part: spoiled(getattr(groups.gaussians, part))})
        groups = replace(groups, gaussians=gaussians)
    with pytest.raises(ValueError, match=rf"0 frames 7,9 .* {part}"):
        predict(lambda views: groups, flat_sample, "predicted")


def test_refinement_on_the_context_photos_sharpens_the_targets(flat_sample):
    plain = predict(oracle(flat_sample), flat_sample, "predicted")
    refined = predict(oracle(flat_sample), flat_sample, "predicted", refine=20)
    photos = flat_sample.target.images[0]
    assert float(psnr(refined.images, photos)) > float(psnr(plain.images, photos)) + 0.5
    assert refined.num_groups_used == plain.num_groups_used
