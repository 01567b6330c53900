"""What goes with a removed object: its halo."""

from dataclasses import replace

import torch

from edited_scenes import assert_bit_equal, assert_consistent
from imported_scene import imported_scene
from instok3d.scene.edits.claim import claimed_rows
from instok3d.scene.edits.ownership import rebuilt
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


def test_without_views_nothing_is_claimed():
    removed = imported_scene().remove(5, claim=True)
    assert [item.id for item in removed.objects] == [2, 7]


def test_several_objects_are_removed_at_once(scene: Scene):
    assert scene.remove(1, 3, claim=True).objects == ()
