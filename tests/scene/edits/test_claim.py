"""What goes with a removed object: its halo."""

from dataclasses import replace

import torch

from edited_scenes import assert_bit_equal, assert_consistent
from imported_scene import imported_scene
from instok3d.scene.edits.claim import claimed_rows
from instok3d.scene.edits.ownership import rebuilt
from instok3d.scene.scene import Scene


def with_halo(scene: Scene, *, of_blue: bool = False) -> Scene:
    """The red blob with four of its Gaussians given to the rest, or to the blue, as a halo is."""
    pi = scene.tokens.assignment.clone()
    # Anchor 0, 4 Gaussians, is now the void's or the blue one's.
    pi[0] = torch.tensor([0.48, 0, 0.52, 0, 0] if of_blue else [0.48, 0, 0, 0, 0.52])
    start = 16 if of_blue else 36
    order = torch.cat([torch.arange(4, 4 + start), torch.arange(4), torch.arange(4 + start, 40)])
    counts = {1: 8, 3: 12 if of_blue else 8}
    tokens = replace(scene.tokens, assignment=pi)
    return rebuilt(scene, scene.gaussians.rows(order), tokens, scene.objects, counts, {1, 3})


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


def test_a_hidden_object_hides_no_halo(scene: Scene):
    screened = with_halo(scene).duplicate(3, (-1.2, 0, -0.6), scale=1.5)
    screen = screened.objects[-1].id
    halo = torch.arange(4) + screened.object(screen).num_gaussians + 36
    assert len(claimed_rows(screened, (1,))) < 4  # it stands before the halo
    assert claimed_rows(screened.hide(screen), (1,)).tolist() == halo.tolist()


def test_nothing_of_a_hidden_object_goes_with_another(scene: Scene):
    haloed = with_halo(scene, of_blue=True)
    assert_consistent(haloed)
    assert claimed_rows(haloed, (1,)).tolist() == [16, 17, 18, 19]
    removed = haloed.hide(3).remove(1, claim=True)
    assert removed.object(3).num_gaussians == 12
    assert torch.equal(removed.show(3).render(only=[3]).colors, haloed.render(only=[3]).colors)


def test_a_hidden_object_takes_its_halo_along(scene: Scene):
    haloed = with_halo(scene)
    assert torch.equal(claimed_rows(haloed.hide(1), (1,)), claimed_rows(haloed, (1,)))
