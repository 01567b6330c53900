"""What goes with a removed object: its halo, and the hole that is marked."""

from dataclasses import replace
from pathlib import Path

import torch

import instok3d
from edited_scenes import assert_bit_equal, assert_consistent
from imported_scene import imported_scene
from instok3d.scene.edits.claim import claimed_rows, hole_of
from instok3d.scene.edits.ownership import given_to, rebuilt
from instok3d.scene.scene import Scene


def with_halo(scene: Scene) -> Scene:
    """The red blob with three of its Gaussians given to the rest, as a halo would be."""
    pi = scene.tokens.assignment.clone()
    pi[0] = torch.tensor([0.48, 0, 0, 0, 0.52])  # anchor 0, 4 Gaussians, is now the void's
    order = torch.cat([torch.arange(4, 40), torch.arange(4)])
    counts = {1: 8, 3: 8}
    tokens = replace(scene.tokens, assignment=pi)
    return rebuilt(scene, scene.gaussians.rows(order), tokens, scene.objects, counts, {1})


def test_a_halo_goes_with_its_object_and_nothing_else_does(scene: Scene):
    haloed = with_halo(scene)
    assert_consistent(haloed)
    rows = claimed_rows(haloed, (1,))
    assert rows.tolist() == [36, 37, 38, 39]
    assert claimed_rows(haloed, (3,)).tolist() == []
    removed = haloed.remove(1, claim=True)
    assert_consistent(removed, sight=True)
    assert len(removed.gaussians.means) == 28
    assert torch.equal(removed.render().colors, scene.remove(1).render().colors)
    assert "and 4 Gaussians at the rim" in removed.edits[0]
    assert_bit_equal(removed.undo(), haloed)


def test_the_hole_is_marked_where_the_object_was_seen(tmp_path: Path, scene: Scene):
    ids = scene.render(ids=True).ids
    removed = scene.remove(1, claim=True)
    hole = removed.hole()
    assert ids is not None
    # Pixels that showed mostly the object are those whose id it was, but for mixed ones.
    assert float((hole == (ids == 1)).float().mean()) > 0.95
    assert 100 < int(hole.sum()) < 400
    removed.save(tmp_path / "room.itk")
    assert torch.equal(instok3d.load(tmp_path / "room.itk").hole(), hole)
    assert not removed.undo().hole().any()
    assert not scene.hole().any()


def test_without_views_nothing_is_claimed_and_no_hole_is_seen():
    removed = imported_scene().remove(5, claim=True)
    assert [item.id for item in removed.objects] == [2, 7]
    assert removed.hole().shape == (0, 24, 32)


def test_several_objects_and_an_object_that_a_claim_empties(scene: Scene):
    both = scene.remove(1, 3, claim=True)
    assert both.objects == ()
    chosen = torch.zeros(40, dtype=torch.bool)
    chosen[:11] = True
    one_left = given_to(scene, chosen, scene.object(3))
    dropped = torch.zeros(40, dtype=torch.bool)
    assert not hole_of(one_left, dropped).any()
