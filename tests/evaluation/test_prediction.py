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
from instok3d.types import TokenGroups, Views

ROOMS = FlatRooms([0], ["easy"])


@pytest.mark.parametrize("mode", ["given", "predicted"])
def test_a_model_that_knows_the_truth_is_nearly_perfect(flat_sample, mode):
    prediction = predict(oracle(flat_sample), flat_sample, mode)
    assert (
        float(psnr(prediction.images, flat_sample.target.images[0])) > 21.5
    )  # edges blur at this size
    matches = match_image(flat_sample.target_instances[0, 0].numpy(), prediction.masks[0])
    assert matches.num_instances == 3
    assert average_precision([matches]).ap50 == 1.0
    assert prediction.num_groups_used == 3


def test_photos_alone_are_shown_in_predicted_mode(flat_sample):
    seen: list[Views] = []

    def model(views: Views) -> TokenGroups:
        seen.append(views)
        return oracle(flat_sample)(views)

    predict(model, flat_sample, "predicted")
    predict(model, flat_sample, "given")
    assert seen[0].cam_from_world is seen[0].depths is seen[0].intrinsics is None
    assert seen[1].depths is not None
    assert torch.equal(seen[0].images, flat_sample.context.images)


def test_another_guess_of_the_scale_changes_nothing(flat_sample):
    plain = predict(oracle(flat_sample), flat_sample, "predicted")
    scaled = predict(oracle(flat_sample, unit=1.7), flat_sample, "predicted")
    torch.testing.assert_close(scaled.images, plain.images, atol=5e-3, rtol=0)
    assert scaled.images_depth_scaled is not None
    torch.testing.assert_close(scaled.images_depth_scaled, plain.images, atol=5e-3, rtol=0)


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
