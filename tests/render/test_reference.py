import math

import pytest
import torch

from instok3d.geometry.cameras import invert_rigid, rigid, transform_points
from instok3d.geometry.rotations import matrix_to_quat, quat_multiply, quat_to_matrix
from instok3d.geometry.spherical_harmonics import rotate_sh
from instok3d.render import RasterSettings, reference, render
from instok3d.types import Cameras, Gaussians

SMOOTH = RasterSettings(alpha_min=0.0, transmittance_min=0.0)


def one_gaussian(*, z=2.0, scale=0.1, opacity=0.5, color=(0.2, 0.4, 0.6)):
    sh = (torch.tensor(color, dtype=torch.float64) - 0.5) / 0.28209479177387814
    return Gaussians(
        means=torch.tensor([[0.0, 0.0, z]], dtype=torch.float64),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64),
        scales=torch.full((1, 3), scale, dtype=torch.float64),
        opacities=torch.tensor([opacity], dtype=torch.float64),
        sh=sh[None, None],
        anchor_index=torch.zeros(1, dtype=torch.long),
    )


def one_camera(*, focal=10.0, center=2.5):
    intrinsics = torch.tensor([[focal, 0, center], [0, focal, center], [0, 0, 1]])
    return Cameras(torch.eye(4, dtype=torch.float64)[None], intrinsics.double()[None])


def stacked(*many):
    return Gaussians(**{k: torch.cat([vars(g)[k] for g in many]) for k in vars(many[0])})


def test_one_gaussian_by_hand():
    # Focal 10, z 2, scale 0.1: standard deviation 0.5 pixels, variance 0.25 + 0.3 = 0.55.
    # Mean at (2.5, 2.5) = the centre of pixel (2, 2); pixel (2, 3) is 1 away: exp(-0.5 / 0.55).
    out = render(one_gaussian(), one_camera(), 5, 5, background=(0.0, 0.0, 1.0))
    alpha = 0.5 * math.exp(-0.5 / 0.55)
    assert out.alphas[0, 2, 2].item() == pytest.approx(0.5)
    assert out.alphas[0, 2, 3].item() == pytest.approx(alpha)
    assert out.colors[0, :, 2, 3].tolist() == pytest.approx(
        [0.2 * alpha, 0.4 * alpha, 0.6 * alpha + 1 - alpha]
    )
    assert out.depths[0, 2, 3].item() == pytest.approx(2.0)
    # Pixel (0, 0): 0.5 exp(-0.5 * 8 / 0.55) = 0.00035 < 1/255: not drawn.
    assert out.alphas[0, 0, 0].item() == 0
    assert out.depths[0, 0, 0].item() == 0


def test_two_gaussians_are_blended_front_to_back_and_features_follow_the_anchors():
    behind, front = one_gaussian(z=4.0, scale=0.2), one_gaussian(z=2.0)
    both = stacked(behind, front)
    both = Gaussians(**{**vars(both), "anchor_index": torch.tensor([1, 0])})
    features = torch.tensor([[1.0, 10.0], [2.0, 20.0]], dtype=torch.float64)
    out = render(both, one_camera(), 5, 5, anchor_features=features)
    # Weights at the centre: 0.5 in front, then 0.5 * 0.5.
    assert out.features is not None
    assert out.features[0, :, 2, 2].tolist() == pytest.approx([1.0, 10.0])
    assert out.alphas[0, 2, 2].item() == pytest.approx(0.75)
    assert out.depths[0, 2, 2].item() == pytest.approx((0.5 * 2 + 0.25 * 4) / 0.75)


def test_a_pixel_ends_before_the_gaussian_that_would_close_it():
    # alpha 0.99 each: T = 0.01, and the second would leave 0.0001, below the limit of 0.001.
    opaque = [one_gaussian(z=z, opacity=1.0) for z in (2.0, 2.1, 2.2)]
    settings = RasterSettings(transmittance_min=0.001)
    out = render(stacked(*opaque), one_camera(), 5, 5, settings=settings)
    assert out.alphas[0, 2, 2].item() == pytest.approx(0.99)


def test_gradients_of_everything_are_those_of_finite_differences(make_scene):
    gaussians, cameras = make_scene(views=2, count=5, anchors=3, degree=3, height=4, width=5)
    features = torch.rand(3, 2, dtype=torch.float64)
    names = ("means", "quats", "scales", "opacities", "sh")

    def pictures(features, cam_from_world, *values):
        scene = Gaussians(
            **dict(zip(names, values, strict=True)), anchor_index=gaussians.anchor_index
        )
        out = render(
            scene, Cameras(cam_from_world, cameras.intrinsics), 4, 5, settings=SMOOTH,
            anchor_features=features, background=(0.3, 0.2, 0.1),
        )  # fmt: skip
        return out.colors, out.alphas, out.depths, out.features

    inputs = [features, cameras.cam_from_world, *(getattr(gaussians, name) for name in names)]
    inputs = [value.clone().requires_grad_() for value in inputs]
    assert torch.autograd.gradcheck(pictures, inputs, fast_mode=True)


def test_chunks_of_pixels_change_nothing(make_scene, monkeypatch):
    def run():
        gaussians, cameras = scene
        means = gaussians.means.clone().requires_grad_()
        out = render(Gaussians(**{**vars(gaussians), "means": means}), cameras, 24, 32)
        out.colors.square().sum().backward()
        return out.colors.detach(), means.grad

    scene = make_scene()
    whole = run()
    monkeypatch.setattr(reference, "PAIRS_IN_MEMORY", 60 * 100)
    torch.testing.assert_close(run(), whole)


def test_a_batch_is_its_scenes_one_by_one(make_scene):
    gaussians, cameras = make_scene(batch=2)
    features = torch.rand(2, 7, 3, dtype=torch.float64)
    both = render(gaussians, cameras, 24, 32, anchor_features=features)
    for scene in range(2):
        alone = render(
            Gaussians(**{k: v[scene] for k, v in vars(gaussians).items()}),
            Cameras(cameras.cam_from_world[scene], cameras.intrinsics[scene]),
            24, 32, anchor_features=features[scene],
        )  # fmt: skip
        for name, value in vars(alone).items():
            torch.testing.assert_close(value, getattr(both, name)[scene])


def test_moving_world_and_cameras_together_changes_nothing(make_scene):
    gaussians, cameras = make_scene(degree=3)
    turn = quat_to_matrix(torch.tensor([0.5, -0.3, 0.7, 0.2], dtype=torch.float64))
    there = rigid(turn, torch.tensor([0.3, -2.0, 1.0], dtype=torch.float64))
    moved = Gaussians(
        means=transform_points(there, gaussians.means),
        quats=quat_multiply(matrix_to_quat(turn).expand_as(gaussians.quats), gaussians.quats),
        scales=gaussians.scales,
        opacities=gaussians.opacities,
        sh=rotate_sh(gaussians.sh, turn),
        anchor_index=gaussians.anchor_index,
    )
    moved_cameras = Cameras(cameras.cam_from_world @ invert_rigid(there), cameras.intrinsics)
    torch.testing.assert_close(
        render(moved, moved_cameras, 24, 32).colors, render(gaussians, cameras, 24, 32).colors
    )
