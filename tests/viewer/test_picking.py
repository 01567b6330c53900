from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from imported_scene import imported_scene
from instok3d.geometry.cameras import project, transform_points
from instok3d.render import render
from instok3d.scene.paths import around
from instok3d.scene.scene import Scene
from instok3d.viewer.picking import Picked, pick
from made_scene import HEIGHT, WIDTH, made_empty_scene, made_scene, made_tokens
from splat_scenes import furnished_scene

STEP = 3
"""Every third pixel in both directions."""


def picked(scene: Scene, view: int = 0) -> list[list[Picked]]:
    pose, lens = scene.cameras.cam_from_world[view], scene.cameras.intrinsics[view]
    return [
        [pick(scene, pose, lens, HEIGHT, WIDTH, (x + 0.5, y + 0.5)) for x in range(1, WIDTH, STEP)]
        for y in range(1, HEIGHT, STEP)
    ]


def largest_shares(scene: Scene, view: int = 0) -> torch.Tensor:
    """By the renderer: one column for each object, one anchor for each Gaussian."""
    columns = torch.nn.functional.one_hot(scene.object_ids(), len(scene.tokens.groups) + 1).float()
    near, far = scene.near_far
    rendering = render(
        replace(scene.gaussians, anchor_index=torch.arange(len(columns))),
        scene.cameras.view(view), HEIGHT, WIDTH, anchor_features=columns, near=near, far=far,
    )  # fmt: skip
    assert rendering.features is not None
    shares = rendering.features[0]
    shares[0] += 1 - rendering.alphas[0]
    return shares.argmax(0)[1::STEP, 1::STEP]


@pytest.mark.parametrize("make", [lambda: made_scene(made_tokens()), furnished_scene])
def test_every_pixel_shows_the_object_with_the_largest_share_of_it(make: Callable[[], Scene]):
    scene = make()
    found = torch.tensor([[each.object for each in row] for row in picked(scene)])
    assert set(found.unique().tolist()) == {0, *(item.id for item in scene.objects)}
    assert (found == largest_shares(scene)).float().mean() > 0.99


def test_the_point_lies_on_the_ray_within_the_object():
    scene = furnished_scene()
    pose, lens = scene.cameras.cam_from_world[1], scene.cameras.intrinsics[1]
    seen = set()
    for x, y in [(10.25, 13.5), (21.0, 14.0), (16.0, 3.0)]:
        found = pick(scene, pose, lens, HEIGHT, WIDTH, (x, y))
        seen.add(found.object)
        assert found.point is not None
        if found.object:
            box = scene.object(found.object).aabb
            inside = zip(box.min, found.point, box.max, strict=True)
            # Splats reach beyond the box of their bulk by up to three standard deviations, 0.33.
            assert all(low - 0.33 <= value <= high + 0.33 for low, value, high in inside)
        pixel = project(transform_points(pose, torch.tensor([found.point])), lens)
        torch.testing.assert_close(pixel, torch.tensor([[x, y]]), atol=1e-3, rtol=0)
    assert seen == {0, 1, 2}


def test_hidden_objects_and_empty_pictures_show_none():
    scene = made_scene(made_tokens()).hide(1, 3)
    assert {each.object for row in picked(scene) for each in row} == {0}
    empty = made_empty_scene()
    nothing = replace(empty, gaussians=empty.gaussians.rows(slice(0, 0)))
    pose, lens = nothing.cameras.cam_from_world[0], nothing.cameras.intrinsics[0]
    assert pick(nothing, pose, lens, HEIGHT, WIDTH, (3.5, 4.5)) == Picked(0, None)


def test_a_scene_without_photos_is_picked_too():
    scene = imported_scene()
    camera = around(scene.gaussians, scene.vertical.up, 60, 80, frames=1)
    ids = scene.render(camera, 60, 80, ids=True).ids
    assert ids is not None
    pose, lens = camera.cam_from_world[0], camera.intrinsics[0]
    for item in scene.objects:
        y, x = (ids[0] == item.id).nonzero().float().median(0).values.tolist()
        found = pick(scene, pose, lens, 60, 80, (x + 0.5, y + 0.5))
        assert found.object == int(ids[0, int(y), int(x)])
