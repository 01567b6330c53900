import math
from dataclasses import replace

import pytest
import torch

from instok3d.evaluation.camera_refinement import refined_cameras
from instok3d.geometry.camera_alignment import baseline_scale, cameras_in_prediction
from instok3d.geometry.cameras import rigid
from instok3d.geometry.rotations import quat_multiply, quat_to_matrix
from instok3d.render import render
from instok3d.types import Cameras, Gaussians


def random_cameras(rng: torch.Generator, count: int) -> Cameras:
    quats = torch.tensor([1.0, 0, 0, 0]) + 0.1 * torch.randn(count, 4, generator=rng)
    shifts = 0.3 * torch.randn(count, 3, generator=rng)
    intrinsics = torch.tensor([[30.0, 0, 16], [0, 31.0, 16], [0, 0, 1]]).repeat(count, 1, 1)
    return Cameras(rigid(quat_to_matrix(quats), shifts), intrinsics)


def random_gaussians(rng: torch.Generator, count: int = 60) -> Gaussians:
    spread = torch.tensor([0.8, 0.8, 0.3])
    return Gaussians(
        means=torch.randn(count, 3, generator=rng) * spread + torch.tensor([0, 0, 3.0]),
        quats=torch.nn.functional.normalize(torch.randn(count, 4, generator=rng), dim=-1),
        scales=0.05 + 0.15 * torch.rand(count, 3, generator=rng),
        opacities=torch.rand(count, generator=rng),
        sh=torch.randn(count, 1, 3, generator=rng),
        anchor_index=torch.arange(count),
    )


def test_scale_is_the_ratio_of_summed_baselines():
    # Centres 0, 1, 3 on a line: true baselines 1, 2, 3, sum 6. Predicted 0, 1, 1: 1, 0, 1, sum 2.
    def line(*centers: float) -> torch.Tensor:
        cameras = torch.eye(4).repeat(len(centers), 1, 1)
        cameras[:, 0, 3] = -torch.tensor(centers)
        return cameras

    assert baseline_scale(line(0, 1, 1), line(0, 1, 3)) == pytest.approx(3.0)
    assert baseline_scale(line(0, 0, 0), line(0, 0, 0)) == 1.0
    assert math.isfinite(baseline_scale(line(0, 0), line(0, 1)))


def test_a_prediction_right_up_to_a_similarity_renders_the_same(rng):
    true = random_cameras(rng, 5)
    scene = random_gaussians(rng)
    expected = render(scene, true, 32, 32)
    # The predicted world: turned by R, shifted by t, in units of 2.5 true ones.
    unit, quat = 2.5, torch.randn(4, generator=rng)
    rotation, shift = quat_to_matrix(quat), torch.randn(3, generator=rng)
    predicted_scene = replace(
        scene,
        means=(scene.means @ rotation.mT + shift) / unit,
        quats=_turned(quat, scene.quats),
        scales=scene.scales / unit,
    )
    predicted_from_true = rigid(rotation, shift)
    cam_from_predicted = true.cam_from_world @ torch.linalg.inv(predicted_from_true)
    cam_from_predicted[:, :3, 3] /= unit
    predicted = Cameras(cam_from_predicted, true.intrinsics)
    context, target = slice(0, 3), slice(3, 5)
    scale = baseline_scale(predicted.cam_from_world[context], true.cam_from_world[context])
    assert scale == pytest.approx(unit, rel=1e-4)
    cameras = cameras_in_prediction(
        Cameras(true.cam_from_world[target], true.intrinsics[target]),
        predicted_context=Cameras(predicted.cam_from_world[context], predicted.intrinsics[context]),
        true_context=Cameras(true.cam_from_world[context], true.intrinsics[context]),
        scale=scale,
    )
    got = render(predicted_scene, cameras, 32, 32, near=0.05 / unit)
    torch.testing.assert_close(got.colors, expected.colors[target], atol=2e-3, rtol=0)
    assert float(expected.alphas[target].mean()) > 0.1  # there is something to see


def test_the_focal_length_follows_that_of_the_context_views(rng):
    cameras = random_cameras(rng, 3)
    # Predicted 10 % and 20 % too long in the two context views: 15 % in the mean.
    predicted = cameras.intrinsics[:2].clone()
    predicted[0, :2, :2] *= 1.1
    predicted[1, :2, :2] *= 1.2
    result = cameras_in_prediction(
        Cameras(cameras.cam_from_world[2:], cameras.intrinsics[2:]),
        predicted_context=Cameras(cameras.cam_from_world[:2], predicted),
        true_context=Cameras(cameras.cam_from_world[:2], cameras.intrinsics[:2]),
        scale=1.0,
    )
    expected = torch.tensor([[34.5, 0, 16], [0, 35.65, 16], [0, 0, 1]])
    torch.testing.assert_close(result.intrinsics[0], expected)
    torch.testing.assert_close(
        result.cam_from_world, cameras.cam_from_world[2:], atol=1e-5, rtol=1e-5
    )


def test_pose_alignment_finds_back_to_the_photo(rng):
    scene, true = random_gaussians(rng), random_cameras(rng, 1)
    photo = render(scene, true, 24, 24).colors
    moved = true.cam_from_world.clone()
    moved[0, 0, 3] += 0.05
    start = replace(true, cam_from_world=moved)
    assert refined_cameras(scene, start, photo, steps=0) is start
    found = refined_cameras(scene, start, photo, steps=30)

    def difference(cameras: Cameras) -> float:
        return float((render(scene, cameras, 24, 24).colors - photo).abs().mean())

    assert difference(found) < 0.3 * difference(start)


def _turned(quat: torch.Tensor, quats: torch.Tensor) -> torch.Tensor:
    quat = torch.nn.functional.normalize(quat, dim=-1)
    return quat_multiply(quat.expand_as(quats), quats)
