"""Edits of scenes: laws that hold of each, and what each does."""

import math
import random
import warnings
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from edited_scenes import assert_bit_equal, assert_consistent, random_edit, source_of, tensors_of
from imported_scene import imported_scene
from instok3d.geometry.cameras import invert_rigid, rigid
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.render import render
from instok3d.scene.boxes import extent_along
from instok3d.scene.edits.ownership import given_to, part_of
from instok3d.scene.refine import refine
from instok3d.scene.scene import Scene
from instok3d.types import Cameras
from made_scene import HEIGHT, WIDTH, made_empty_scene, made_scene, made_tokens

FAR_AWAY = ((-1e6, -1e6, -1e6), (-0.4, 1e6, 1e6))
EDITS: dict[str, Callable[[Scene], Scene]] = {
    "only": lambda scene: scene.only(3),
    "remove": lambda scene: scene.remove(1),
    "remove both": lambda scene: scene.remove(1, "object#3"),
    "move": lambda scene: scene.move(1, (0.1, 0.2, -0.3)),
    "turn": lambda scene: scene.move(1, yaw=30, scale=1.5),
    "duplicate": lambda scene: scene.duplicate(3, (0.2, 0.0, 0.0), yaw=10),
    "insert": lambda scene: scene.insert(made_scene(made_tokens()), 1, (0.0, 0.3, 1.5)),
    "insert imported": lambda scene: scene.insert(imported_scene(), 5, (0, 0, 2), scale=0.2),
    "recolor": lambda scene: scene.recolor(1, "lime"),
    "merge": lambda scene: scene.merge(3, 1),
    "split": lambda scene: scene.split(1, gap=0.1),
    "rename": lambda scene: scene.rename(3, "blue ball"),
    "hide": lambda scene: scene.hide(1),
    "show": lambda scene: scene.hide(1).show(1),
}


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", EDITS)
def test_every_edit_keeps_the_scene_consistent_and_is_undone_bit_for_bit(name: str, scene: Scene):
    before = [value.clone() for value in tensors_of(scene)]
    edited = EDITS[name](scene)
    assert_consistent(edited, sight=True)
    assert all(torch.equal(a, b) for a, b in zip(before, tensors_of(scene), strict=True))
    undone = edited
    while undone.edits:
        undone = undone.undo()
    assert_bit_equal(undone, scene)
    while undone.history is not None and undone.history.undone:
        undone = undone.redo()
    assert_bit_equal(undone, edited)
    assert len(edited.provenance.edited_from) == 64


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", EDITS)
def test_edits_of_an_imported_scene_are_the_same_edits(name: str):
    imported = imported_scene((1, 0, 3), each=12)
    scene = replace(imported, near_far=(0.01, 100.0))
    edited = EDITS[name](scene)
    assert_consistent(edited, sight=True)
    assert edited.history is not None
    assert_bit_equal(edited.history.source, source_of(scene))


@pytest.mark.parametrize("name", EDITS)
def test_outside_of_old_and_new_footprint_every_picture_is_bit_equal(name: str, scene: Scene):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        edited = EDITS[name](scene)
    touched = {"only": [1], "remove": [1], "remove both": [1, 3], "duplicate": [], "insert": [],
               "insert imported": [], "merge": [], "split": [], "rename": [], "hide": [1],
               "show": []}.get(name, [1])  # fmt: skip
    footprint = scene.render(only=touched).alphas > 0 if touched else torch.tensor(False)
    new = [item.id for item in edited.objects if item.id > 4] + [
        number for number in touched if number in [item.id for item in edited.objects]
    ]
    if name not in ("merge", "split") and new:
        footprint = footprint | (edited.render(only=new).alphas > 0)
    if name == "only":  # the rest goes too
        rest = replace(scene, gaussians=scene.gaussians.rows(scene.object_ids() == 0))
        footprint = footprint | (rest.render().alphas > 0)
    before, after = scene.render().colors, edited.render().colors
    same = (before == after).all(dim=1)
    assert (same | footprint).all()
    changes = name not in ("rename", "show", "merge", "split")
    assert bool((~same).any()) == changes


def test_turning_the_object_is_turning_the_camera_around_it(scene: Scene):
    alone = scene.only(1)
    up = torch.tensor(alone.vertical.up)
    pivot = torch.tensor([-0.5, 0.1, 2.0])
    turned = alone.move(1, yaw=50, about=pivot.tolist())
    angle_rad = math.radians(50)
    quat = torch.cat([torch.tensor([math.cos(angle_rad / 2)]), math.sin(angle_rad / 2) * up])
    rotation = quat_to_matrix(quat)
    world_from_object = rigid(rotation, pivot - rotation @ pivot)
    cameras = Cameras(scene.cameras.cam_from_world @ world_from_object, scene.cameras.intrinsics)
    seen = alone.render(cameras, HEIGHT, WIDTH).colors
    assert float((turned.render().colors - seen).abs().max()) <= 1e-4
    assert float((turned.render().colors - alone.render().colors).abs().max()) > 0.1


def test_scaling_the_object_is_coming_nearer(scene: Scene):
    alone = scene.only(1)
    center = invert_rigid(scene.cameras.cam_from_world[0])[:3, 3]
    larger = alone.move(1, scale=1.5, about=center.tolist())
    first = scene.cameras.view(0)
    # About the camera's own place nothing changes in its picture but depth.
    a, b = (each.render(first, HEIGHT, WIDTH) for each in (alone, larger))
    assert float((a.colors - b.colors).abs().max()) <= 1e-4
    hit = a.alphas > 0.5
    torch.testing.assert_close(b.depths[hit], 1.5 * a.depths[hit])


def test_weights_of_the_groups_alone_add_up_to_the_whole(scene: Scene):
    # Composited one-hot features: each object's share of every pixel, and the rest's.
    edited = scene.duplicate(1, (0.3, 0, 0)).merge(3, 5)
    pi = torch.nn.functional.one_hot(
        edited.tokens.assignment.argmax(1), edited.tokens.assignment.shape[1]
    ).float()
    near, far = edited.near_far
    picture = render(edited.gaussians, edited.cameras, HEIGHT, WIDTH, anchor_features=pi,
                     near=near, far=far)  # fmt: skip
    assert picture.features is not None
    torch.testing.assert_close(picture.features.sum(1), picture.alphas, atol=1e-5, rtol=0)


@pytest.mark.parametrize("count", [100, pytest.param(1000, marks=pytest.mark.slow)])
def test_random_edits_keep_every_law_and_are_all_undone(scene: Scene, count: int):
    draw, edited = random.Random(7), scene
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for number in range(count):
            edited = random_edit(edited, scene, draw)
            if number % 20 == 0:
                assert_consistent(edited, sight=number % 40 == 0)
    assert len(edited.edits) == count
    assert edited.history is not None
    assert_bit_equal(edited.history.replayed((), ()).current, source_of(scene))
    again = edited.history.replayed(edited.history.edits, ()).current
    assert_bit_equal(again, source_of(edited))
    assert_bit_equal(edited.undo().redo(), edited)


def test_a_new_edit_ends_redoing(scene: Scene):
    other = scene.remove(1).undo().move(3, (0.1, 0, 0))
    with pytest.raises(ValueError, match="nothing to redo"):
        other.redo()
    with pytest.raises(ValueError, match="nothing to undo"):
        scene.undo()


def test_what_is_made_anew_of_an_edited_scene_cannot_be_undone_past_that(scene: Scene):
    edited = scene.remove(1)
    lighter = replace(edited, gaussians=replace(
        edited.gaussians, opacities=edited.gaussians.opacities * 0.5))  # fmt: skip
    with pytest.raises(ValueError, match="nothing to undo"):
        lighter.undo()
    again = lighter.move(3, (0.1, 0, 0))
    assert_bit_equal(again.undo(), lighter)
    assert again.edits == ("remove object#1", "move object#3 by (0.1, 0, 0)")
    assert again.provenance.edited_from == edited.provenance.edited_from


def test_a_moved_object_stands_where_it_was_moved_to(scene: Scene):
    before, moved = scene.object(1), scene.move(1, (0.1, 0.2, -0.3)).object(1)
    for axis, way in enumerate((0.1, 0.2, -0.3)):
        assert moved.centroid[axis] == pytest.approx(before.centroid[axis] + way, abs=1e-5)
    a, b = (s.part(1) for s in (scene, scene.move(1, (0.1, 0.2, -0.3))))
    for name in ("quats", "scales", "opacities", "sh"):
        assert torch.equal(vars(a)[name], vars(b)[name])


def test_yaw_is_counter_clockwise_seen_from_above():
    # Up is -y: seen from above with z away from the viewer's feet, x to the right, a quarter turn
    # takes the x axis to +z, since up x right = (-y) x (+x) = +z.
    scene = imported_scene((1,), each=40)
    turned = scene.move(1, yaw=90, about=(0, 0, 0))
    before, after = scene.gaussians.means, turned.gaussians.means
    torch.testing.assert_close(after[:, 2], before[:, 0], atol=1e-5, rtol=0)
    torch.testing.assert_close(after[:, 1], before[:, 1], atol=1e-5, rtol=0)


def test_turn_and_scale_leave_the_base_where_it_is(scene: Scene):
    up = scene.vertical.up
    low = extent_along(scene.part(1), up)[0]
    for edited in (scene.move(1, yaw=70), scene.move(1, scale=2)):
        assert extent_along(edited.part(1), up)[0] == pytest.approx(low, abs=1e-4)


def test_an_inserted_object_stands_upright_on_the_surface():
    floor = imported_scene((1,), each=400)
    flat = replace(floor.gaussians, means=floor.gaussians.means * torch.tensor([1, 0.0, 1]))
    floor = replace(floor, gaussians=flat)
    other = imported_scene((4,), each=50)
    tipped = replace(other, vertical=replace(other.vertical, up=(0.0, 0.0, 1.0), confidence=1.0))
    floor = replace(floor, vertical=replace(floor.vertical, confidence=1.0))
    height = extent_along(other.part(4), (0.0, 0.0, 1.0))
    placed = floor.insert(tipped, 4, (0.2, -5.0, 0.1), on=1, scale=0.5)
    item = placed.objects[-1]
    low, high = extent_along(placed.part(item.id), floor.vertical.up)
    assert low == pytest.approx(0.0, abs=1e-5)
    assert high - low == pytest.approx(0.5 * (height[1] - height[0]), rel=1e-3)
    with pytest.raises(ValueError, match="has no surface above or below"):
        floor.insert(tipped, 4, (50.0, 0.0, 0.0), on=1, scale=0.5)


def test_an_object_of_another_model_gets_tokens_of_zeros(scene: Scene):
    other = replace(scene, provenance=replace(scene.provenance, model_sha256="1" * 64))
    same, foreign = scene.insert(scene, 1, (0, 0, 1)), scene.insert(other, 1, (0, 0, 1))
    assert torch.equal(same.tokens.groups[-1], scene.tokens.groups[0])
    assert not foreign.tokens.groups[-1].any()


def test_colours_of_more_bands_come_in_without_changing_others(scene: Scene):
    other = made_scene(made_tokens(sh_count=16))
    edited = scene.insert(other, 1, (0, 0, 30.0))
    assert edited.gaussians.sh.shape[1] == 16
    assert edited.object(5).num_gaussians == 12
    near = edited.remove(5)
    assert torch.equal(near.render().colors, scene.render().colors)


def test_a_recoloured_object_has_that_colour_on_average_and_its_shading():
    scene = imported_scene((1,), each=60)
    color = (0.8, 0.2, 0.1)
    red = scene.recolor(1, color).gaussians
    weights = red.opacities / red.opacities.sum()
    mean = (weights[:, None] * (0.5 + 0.28209479 * red.sh[:, 0])).sum(0)
    assert mean.tolist() == pytest.approx(color, abs=1e-4)
    assert float(red.sh[:, 0].std(dim=0).max()) > 0.05
    black = replace(scene, gaussians=replace(scene.gaussians, sh=scene.gaussians.sh * 0 - 5))
    flat = black.recolor(1, "red").gaussians.sh
    torch.testing.assert_close(0.5 + 0.28209479 * flat[:, 0, 0], torch.ones(60))


def test_pieces_that_stand_apart_become_objects():
    # Two clusters 3 apart in one object, and a crumb of one faint Gaussian far away.
    whole = imported_scene((1, 2, 3), each=60).merge(1, 2, 3)
    parts = whole.split(1, gap=0.9)
    assert sorted(item.num_gaussians for item in parts.objects) == [60, 60, 60]
    centers = sorted(item.centroid[0] for item in parts.objects)
    assert centers == pytest.approx([0, 3, 6], abs=0.5)
    assert_consistent(parts)
    with pytest.raises(ValueError, match="one connected piece"):
        whole.split(1, gap=4.0)


def test_single_gaussians_take_a_copy_of_their_anchor_along(scene: Scene):
    chosen = torch.zeros(40, dtype=torch.bool)
    chosen[[0, 1, 4, 5, 6, 7, 20]] = True  # some of anchor 0, all of anchor 1, one of the rest's
    given = given_to(scene, chosen, scene.object(3))
    assert_consistent(given)
    assert [item.num_gaussians for item in given.objects] == [6, 15]
    assert len(given.tokens.positions) == 10 + 2
    assert sorted(part_of(given, given.objects[1]).gaussians.means[:, 0].tolist()) == sorted(
        [*scene.gaussians.means[chosen, 0].tolist(), *scene.part(3).means[:, 0].tolist()]
    )


def test_hidden_objects_are_there_but_not_drawn(scene: Scene):
    hidden = scene.hide(1)
    assert torch.equal(hidden.render().colors, scene.remove(1).render().colors)
    assert torch.equal(hidden.render(only=1).colors, scene.render(only=1).colors)
    assert hidden.drawn().objects == scene.remove(1).objects
    assert hidden.object(1).best_view == scene.object(1).best_view


def test_an_empty_scene_takes_objects(scene: Scene):
    empty = made_empty_scene()
    filled = empty.insert(scene, 3, (0.0, 0.3, 2.0))
    assert [item.key for item in filled.objects] == ["object#5"]
    assert_consistent(filled, sight=True)
    assert_consistent(filled.remove(5), sight=True)
    nothing = scene.only(1).remove(1)
    assert len(nothing.gaussians.means) == 0 == len(nothing.tokens.positions)
    assert float(nothing.render().alphas.max()) == 0


WRONG: dict[str, tuple[Callable[[Scene], object], str]] = {
    "no object 2 in this scene; its ids are: 1, 3": (lambda s: s.remove(2), "KeyError"),
    "no object 'lamp'": (lambda s: s.move("lamp", (0, 0, 1)), "KeyError"),
    "no object True": (lambda s: s.hide(True), "KeyError"),
    "name at least one object": (lambda s: s.only(), "ValueError"),
    "by must be three finite": (lambda s: s.move(1, (0, math.nan, 0)), "ValueError"),
    "by must be three": (lambda s: s.move(1, (0, 1)), "ValueError"),
    "by must be three finite numbers": (lambda s: s.move(1, (0, 0, 1e30)), "ValueError"),
    "scale must be a number above 0": (lambda s: s.move(1, scale=0), "ValueError"),
    "scale must be": (lambda s: s.move(1, scale=math.inf), "ValueError"),
    "scale must be a": (lambda s: s.insert(s, 1, (0, 0, 0), scale=-1), "ValueError"),
    "yaw must be a finite number": (lambda s: s.move(1, yaw=math.inf), "ValueError"),
    "axis must have a length": (lambda s: s.move(1, yaw=3, axis=(0, 0, 0)), "ValueError"),
    "about must be": (lambda s: s.move(1, yaw=3, about=(0, 0)), "ValueError"),
    "say where the object is to stand": (lambda s: s.insert(s, 1), "ValueError"),
    "at must be three finite": (lambda s: s.insert(s, 1, (0, 0, math.nan)), "ValueError"),
    "'blurple' is no colour": (lambda s: s.recolor(1, "blurple"), "ValueError"),
    "three numbers in": (lambda s: s.recolor(1, (1, 2, 3)), "ValueError"),
    "two or more different objects": (lambda s: s.merge(1, "object#1"), "ValueError"),
    "the box holds none of": (lambda s: s.split(1, box=((7,) * 3, (8,) * 3)), "ValueError"),
    "the box holds all of": (lambda s: s.split(1, box=((-9,) * 3, (9,) * 3)), "ValueError"),
    "gap must be": (lambda s: s.split(1, gap=0), "ValueError"),
    "1 to 100 printable": (lambda s: s.rename(1, " "), "ValueError"),
    "could be taken for an id": (lambda s: s.rename(1, "12"), "ValueError"),
    "that are no finite numbers within": (
        lambda s: s.move(1, scale=1e6).move(1, scale=1e6), "ValueError"
    ),
}  # fmt: skip


@pytest.mark.parametrize("sentence", WRONG)
def test_what_cannot_be_done_is_said_in_a_sentence(sentence: str, scene: Scene):
    edit, kind = WRONG[sentence]
    with pytest.raises((KeyError, ValueError), match=sentence) as caught:
        edit(scene)
    assert caught.type.__name__ == kind


def test_refining_an_edited_scene_warns_and_keeps_names_and_provenance(scene: Scene):
    edited = scene.rename(3, "ball").hide(1)
    with pytest.warns(UserWarning, match="the scene was edited, and its photos show it as it was"):
        refined = refine(edited, steps=1)
    assert [item.key for item in refined.objects] == ["object#1", "ball#3"]
    assert refined.object(1).hidden
    assert refined.edits == edited.edits
    with pytest.raises(ValueError, match="nothing to undo"):
        refined.undo()
