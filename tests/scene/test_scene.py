import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from instok3d import load
from instok3d.geometry.cameras import invert_rigid
from instok3d.scene.from_tokens import MIN_PIXELS
from instok3d.scene.scene import Scene
from instok3d.types import Cameras
from made_scene import HEIGHT, WIDTH, made_scene, made_tokens


def turned(angle_rad: float) -> torch.Tensor:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return torch.tensor([[c, 0, s, 0.4], [0, 1, 0, -0.2], [-s, 0, c, 0.3], [0, 0, 0, 1.0]])


def test_objects_are_the_groups_that_win_anchors_and_pixels(scene: Scene):
    # Group 1 wins no anchor, group 3 stands behind the cameras, the void is no object.
    assert [item.id for item in scene.objects] == [1, 3]
    assert [item.key for item in scene.objects] == ["object#1", "object#3"]
    assert [item.num_anchors for item in scene.objects] == [3, 2]
    assert all(0.5 < item.confidence <= 1 for item in scene.objects)
    assert all(item.visible_in == (0, 1) for item in scene.objects)


def test_a_scene_shows_counts_and_units_on_one_line(scene: Scene, empty_scene: Scene):
    expected = "<Scene objects=2 gaussians=40 views=2 size=24x32 units=arbitrary warnings=0>"
    assert repr(scene) == expected
    assert repr(empty_scene).startswith("<Scene objects=0 ")
    pictures = scene.render([0], ids=True)
    assert "colors=float32[1, 3, 24, 32]" in repr(pictures)
    assert "ids=int64[1, 24, 32]" in repr(pictures)
    assert "\n" not in repr(pictures)


def test_gaussians_stand_sorted_by_object_with_the_rest_last(scene: Scene):
    # 3 and 2 anchors of 4 Gaussians; 4 void anchors and the hidden one are the rest.
    assert [item.gaussian_range for item in scene.objects] == [(0, 12), (12, 8)]
    owner = scene.tokens.assignment.argmax(1)[scene.gaussians.anchor_index]
    assert owner.tolist() == [0] * 12 + [2] * 8 + [4] * 16 + [3] * 4
    assert scene.object_ids().tolist() == [1] * 12 + [3] * 8 + [0] * 20


def test_sorting_loses_no_gaussian_and_changes_no_picture():
    tokens = made_tokens()
    scene = made_scene(tokens)
    raw = {name: value[0] for name, value in vars(tokens.gaussians).items()}
    unsorted = replace(scene, gaussians=type(tokens.gaussians)(**raw))
    torch.testing.assert_close(scene.render().colors, unsorted.render().colors)


def test_ids_point_at_the_objects_and_agree_with_their_records(scene: Scene):
    ids = scene.render(ids=True).ids
    assert ids is not None
    assert set(ids.unique().tolist()) == {0, 1, 3}
    for item in scene.objects:
        pixels = ids[item.best_view.view] == item.id
        y, x = pixels.nonzero(as_tuple=True)
        box = (int(x.min()), int(y.min()), int(x.max()) + 1, int(y.max()) + 1)
        assert item.best_view.bbox == box
        assert item.best_view.pixels == int(pixels.sum()) >= MIN_PIXELS
    # The red blob lies to the left of the blue one.
    assert scene.object(1).best_view.bbox[2] < scene.object(3).best_view.bbox[0]


def test_only_draws_one_object(scene: Scene):
    picture = scene.render(only=1).colors
    right = picture[..., WIDTH // 2 + 4 :]
    assert float(right.max()) < 0.05 < 0.5 < float(picture.max())
    both = scene.render(only=["object#3", 1])
    assert float(both.alphas[..., WIDTH // 2 + 4 :].max()) > 0.5


def test_unknown_objects_and_views_are_named(scene: Scene):
    with pytest.raises(KeyError, match=r"no object 2 in this scene; its ids are: 1, 3"):
        scene.render(only=2)
    with pytest.raises(ValueError, match=r"0\.\.1, got \[2\]"):
        scene.render([2])


def test_a_larger_picture_of_an_input_shows_the_same(scene: Scene):
    small = scene.render([1]).colors
    large = scene.render([1], 4 * HEIGHT, 4 * WIDTH).colors
    assert large.shape == (1, 3, 4 * HEIGHT, 4 * WIDTH)
    shrunk = torch.nn.functional.avg_pool2d(large, 4)
    assert float((shrunk - small).square().mean()) < 1e-3


def test_given_cameras_move_the_scene_and_no_picture():
    # The same world seen from cameras that stand elsewhere, turned by 0.7 rad: colours too must
    # turn, since the Gaussians' bands of degree 1 and 2 are not zero.
    tokens = made_tokens(sh_count=9)
    plain = made_scene(tokens)
    world_from_first = turned(0.7)
    cam_from_world = plain.cameras.cam_from_world @ invert_rigid(world_from_first)
    moved = made_scene(tokens, cam_from_world=cam_from_world, units="metres")
    assert (moved.frame, moved.units) == ("given cameras", "metres")
    torch.testing.assert_close(moved.render().colors, plain.render().colors, atol=2e-4, rtol=0)
    torch.testing.assert_close(moved.cameras.cam_from_world, cam_from_world)
    place = world_from_first[:3, :3] @ torch.tensor(plain.objects[0].centroid)
    place = place + world_from_first[:3, 3]
    torch.testing.assert_close(torch.tensor(moved.objects[0].centroid), place, atol=1e-4, rtol=0)
    assert [item.gaussian_range for item in moved.objects] == [(0, 12), (12, 8)]


def test_cameras_of_ones_own_are_taken_as_they_are(scene: Scene):
    own = Cameras(scene.cameras.cam_from_world[:1], scene.cameras.intrinsics[:1])
    same = scene.render(own, HEIGHT, WIDTH).colors
    torch.testing.assert_close(same, scene.render([0]).colors)


def test_a_scene_without_objects_renders_its_rest(empty_scene: Scene):
    assert empty_scene.objects == ()
    pictures = empty_scene.render(ids=True)
    assert pictures.ids is not None
    assert not pictures.ids.any()
    assert float(pictures.alphas.max()) > 0.5


def test_gaussians_that_are_not_finite_are_dropped_and_told():
    tokens = made_tokens()
    means = tokens.gaussians.means.clone()
    means[0, 0, 0] = torch.nan
    with pytest.warns(UserWarning, match="dropped 1 Gaussians"):
        scene = made_scene(replace(tokens, gaussians=replace(tokens.gaussians, means=means)))
    assert scene.objects[0].num_gaussians == 11
    assert scene.warnings == ("dropped 1 Gaussians that were not finite",)


def test_tokens_that_are_not_finite_are_refused():
    tokens = made_tokens()
    with pytest.raises(ValueError, match="not finite; try another model"):
        made_scene(replace(tokens, tokens=tokens.tokens * torch.nan))


def test_a_scene_of_no_gaussians_is_black_and_can_be_kept(tmp_path: Path):
    tokens = made_tokens()
    means = torch.full_like(tokens.gaussians.means, torch.nan)
    with pytest.warns(UserWarning, match="dropped 40 Gaussians"):
        scene = made_scene(replace(tokens, gaussians=replace(tokens.gaussians, means=means)))
    assert scene.objects == ()
    assert not scene.render(ids=True).colors.any()
    scene.save(tmp_path / "room.itk")
    assert load(tmp_path / "room.itk").gaussians.means.shape == (0, 3)


def test_a_batch_of_two_is_refused():
    tokens = made_tokens()
    with pytest.raises(ValueError, match="batch of one, got 2"):
        made_scene(replace(tokens, tokens=tokens.tokens.repeat(2, 1, 1),
                           assignment=tokens.assignment.repeat(2, 1, 1)))  # fmt: skip
