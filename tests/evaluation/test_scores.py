import math
from dataclasses import replace

import pytest
import torch

from flat_rooms import oracle
from instok3d.evaluation.instance_ap import ApSettings
from instok3d.evaluation.prediction import predict
from instok3d.evaluation.scores import score_geometry, score_views


def test_what_is_not_measured_is_none(flat_sample):
    (pictures,) = score_views(flat_sample, flat_sample.target.images[0], None, ApSettings())
    assert pictures.psnr == pytest.approx(100)
    assert pictures.lpips is pictures.matches is pictures.psnr_depth_scaled is None
    masks = predict(oracle(flat_sample), flat_sample, "given").masks
    (found,) = score_views(flat_sample, None, masks, ApSettings())
    assert found.psnr is found.ssim is None
    assert found.matches is not None


def test_a_picture_that_is_no_number_is_an_error_that_names_the_sample(flat_sample):
    images = flat_sample.target.images[0].clone()
    images[0, 1, 5, 7] = torch.nan
    with pytest.raises(ValueError, match=r"psnr of 0 frames 7,9, target 0, is nan"):
        score_views(flat_sample, images, None, ApSettings())


def test_geometry_without_truth_is_none_and_that_is_no_number_an_error(flat_sample):
    geometry = predict(oracle(flat_sample), flat_sample, "predicted").geometry
    blind = replace(flat_sample.context, depths=torch.zeros_like(flat_sample.context.depths))
    score = score_geometry(replace(flat_sample, context=blind), geometry)
    assert score.depth_rel is score.depth_rel_unscaled is score.length_rel is None
    assert score.rotation_deg == pytest.approx(0, abs=1e-3)
    broken = geometry.depths.clone()
    broken[0, 0, 0, 0] = torch.nan
    with pytest.raises(ValueError, match="of 0 frames 7,9 is nan"):
        score_geometry(flat_sample, replace(geometry, depths=broken))


def test_views_from_one_place_have_no_direction_but_a_rotation(flat_sample):
    geometry = predict(oracle(flat_sample), flat_sample, "predicted").geometry
    together = flat_sample.context.cam_from_world.clone()
    together[..., :3, 3] = 0
    context = replace(flat_sample.context, cam_from_world=together)
    score = score_geometry(replace(flat_sample, context=context), geometry)
    assert score.direction_deg is score.length_rel is None
    assert not math.isnan(score.rotation_deg)
