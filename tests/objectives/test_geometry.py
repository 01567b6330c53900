import math
from dataclasses import replace

import pytest
import torch

from instok3d.backbones.nano.backbone import NanoBackbone, NanoConfig
from instok3d.geometry.cameras import intrinsics_from_field_of_view
from instok3d.objectives.geometry import geometry_loss, true_matches
from instok3d.types import Views

SIZE = 32
INTRINSICS = intrinsics_from_field_of_view(torch.tensor(2 * math.atan(0.5)), SIZE, SIZE)
"""Focal length 32 pixels, principal point (16, 16)."""


def wall(views: int = 2) -> Views:
    """A wall two metres away, seen by cameras that differ in nothing."""
    return Views(
        images=torch.rand(1, views, 3, SIZE, SIZE, generator=torch.Generator().manual_seed(1)),
        intrinsics=INTRINSICS.expand(1, views, 3, 3),
        cam_from_world=torch.eye(4).expand(1, views, 4, 4),
        depths=torch.full((1, views, SIZE, SIZE), 2.0),
    )


@pytest.fixture
def backbone() -> NanoBackbone:
    torch.manual_seed(0)
    return NanoBackbone(NanoConfig(width=64, layers=1, match_channels=16))


def test_camera_that_steps_aside_sees_the_wall_shifted_by_hand():
    # 0.25 m to the right before a wall 2 m away: 0.25 / 2 * 32 = 4 pixels to the left.
    b_from_a = torch.eye(4)[None].clone()
    b_from_a[0, 0, 3] = -0.25
    depth = torch.full((1, SIZE, SIZE), 2.0)
    k = INTRINSICS[None]
    cells = torch.tensor([0, 1, 9])  # centres (2, 2), (6, 2), (6, 6)
    found = true_matches(depth, k, depth, k, b_from_a, cells)
    expected = torch.tensor([[[-2.0, 2.0], [2.0, 2.0], [2.0, 6.0]]])
    torch.testing.assert_close(found.pixels, expected)
    assert found.visible.tolist() == [[False, True, True]]


def test_what_something_nearer_hides_is_not_visible():
    far, near = torch.full((1, SIZE, SIZE), 2.0), torch.full((1, SIZE, SIZE), 1.0)
    k = INTRINSICS[None]
    found = true_matches(far, k, near, k, torch.eye(4)[None], torch.arange(4))
    assert not found.visible.any()
    assert found.known.all()


def test_one_wrong_scale_costs_nothing_but_the_scale_term(backbone):
    true = wall()
    raw = backbone.encode(true)
    flat = replace(raw, log_depths=torch.full_like(raw.log_depths, math.log(3.0)))
    loss = geometry_loss(backbone, flat, true)
    assert float(loss.depth) == pytest.approx(0.0, abs=1e-6)
    assert float(loss.gradient) == pytest.approx(0.0, abs=1e-6)
    assert float(loss.scale) == pytest.approx(math.log(3.0), abs=1e-5)


def test_depth_error_by_hand(backbone):
    # Two views right, two wrong by a factor e^0.2: the median scale is one of the two, the mean
    # absolute error 0.1 either way.
    true = wall(views=4)
    raw = backbone.encode(true)
    log_depths = torch.zeros_like(raw.log_depths)
    log_depths[:, 2:] = 0.2
    loss = geometry_loss(backbone, replace(raw, log_depths=log_depths), true)
    assert float(loss.depth) == pytest.approx(0.1, abs=1e-5)


def test_scene_without_known_depth_gives_a_finite_loss(backbone):
    true = replace(wall(), depths=torch.zeros(1, 2, SIZE, SIZE))
    loss = geometry_loss(backbone, backbone.encode(true), true)
    loss.total.backward()
    assert loss.total.isfinite()


def test_missing_truth_is_named(backbone):
    true = wall()
    raw = backbone.encode(true)
    with pytest.raises(ValueError, match="depths, cam_from_world and intrinsics"):
        geometry_loss(backbone, raw, Views(true.images))


def test_a_few_steps_on_one_wall_lower_the_loss(backbone):
    true = wall()
    optimizer = torch.optim.AdamW(backbone.parameters(), lr=1e-3)
    losses = []
    for _ in range(15):
        loss = geometry_loss(backbone, backbone.encode(true), true).total
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.7 * losses[0]
