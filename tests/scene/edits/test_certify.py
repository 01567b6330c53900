from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from instok3d.scene.edits.certify import Certificate, certify, only_in_first
from instok3d.scene.scene import Scene


def certificate(before: Scene, after: Scene) -> Certificate:
    return certify(before, after, before.cameras, before.height, before.width)


@pytest.mark.parametrize(
    ("edit", "gone", "new"),
    [
        (lambda scene: scene.remove(1), 12, 0),
        (lambda scene: scene.move(3, (0.1, 0, 0)), 8, 8),
        (lambda scene: scene.duplicate(3, (0.3, 0.2, 0)), 0, 8),
        (lambda scene: scene.duplicate(3, (0, 0, 0)), 0, 8),
        (lambda scene: scene.recolor(1, "red"), 12, 12),
        (lambda scene: scene.hide(3), 8, 0),
        (lambda scene: scene.rename(1, "x").merge(1, 3), 8, 8),
        (lambda scene: scene.rename(1, "x").hide(1).show(1), 0, 0),
    ],
)
def test_outside_of_what_was_edited_nothing_differs(
    edit: Callable[[Scene], Scene], gone: int, new: int, scene: Scene
):
    found = certificate(scene, edit(scene))
    assert (found.outside, found.gone, found.new) == (0.0, gone, new)
    assert found.pixels == 2 * 24 * 32
    assert 0 < found.pixels_outside <= found.pixels
    if gone or new:
        assert found.pixels_outside < found.pixels


def test_of_equal_depth_the_order_changes_within_the_footprint_alone(scene: Scene):
    # The copies lie at the same depths as their originals, so that they are drawn by their order.
    twice = scene.duplicate(3, (0.05, 0.05, 0)).recolor(5, "red")
    merged = twice.merge(1, 5)
    found = certificate(twice, merged)
    assert (found.outside, found.gone, found.new) == (0.0, 8, 8)
    assert not torch.equal(twice.render().colors, merged.render().colors)


def test_a_difference_outside_is_found(scene: Scene):
    # Two of equal depth and one owner, exchanged: the same Gaussians, another picture.
    twice = scene.duplicate(3, (0, 0, 0)).recolor(5, "red").merge(3, 5)
    start, count = twice.object(3).gaussian_range
    order = torch.arange(len(twice.gaussians.means))
    order[start : start + count] = order[start : start + count].flip(0)
    other = replace(twice, gaussians=twice.gaussians.rows(order))
    found = certificate(twice, other)
    assert (found.gone, found.new, found.pixels_outside) == (0, 0, found.pixels)
    assert found.outside > 0.1


def test_equal_gaussians_are_counted(scene: Scene):
    ids = torch.tensor([1, 1, 1, 1])
    two = scene.gaussians.rows(torch.tensor([0, 0, 1, 2]))
    one = scene.gaussians.rows(torch.tensor([0, 2, 2]))
    assert only_in_first(two, ids, one, ids[:3]).tolist() == [False, True, True, False]
    assert only_in_first(one, ids[:3], two, ids).tolist() == [False, False, True]
    assert only_in_first(one, ids[:3] + 1, two, ids).all()
    none = scene.gaussians.rows(slice(0, 0))
    assert only_in_first(none, ids[:0], one, ids[:3]).tolist() == []
    assert only_in_first(one, ids[:3], none, ids[:0]).all()
