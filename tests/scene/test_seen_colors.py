"""Colours that objects show, by which "the red chair" beats the blue one."""

import pytest
import torch

from imported_scene import imported_scene
from instok3d.scene.scene import Scene
from instok3d.scene.seen_colors import FLOOR, seen_color_shares
from instok3d.semantics.query.ranking import COLOR_NAMES
from made_encoder import made_encoder


def test_shares_are_those_of_the_objects_pixels_and_follow_edits(scene: Scene):
    # The red blob, object 1, and the blue one, object 3.
    shares = seen_color_shares(scene, scene.objects)
    assert shares is not None
    assert [COLOR_NAMES[place] for place in shares.argmax(dim=1)] == ["red", "blue"]
    torch.testing.assert_close((shares - FLOOR).sum(dim=1), torch.ones(2))
    painted = scene.recolor(1, "lime")
    after = seen_color_shares(painted, painted.objects)
    assert after is not None
    assert [COLOR_NAMES[place] for place in after.argmax(dim=1)] == ["green", "blue"]


def test_a_question_after_a_colour_follows_a_recoloured_object(scene: Scene):
    def likely(room: Scene, color: str) -> float:
        return room.query(f"the {color} chair", encoder=made_encoder()).ranked[0].probability

    painted = scene.recolor(1, "lime")
    assert likely(scene, "red") > 3 * likely(scene, "green")
    assert likely(painted, "green") > 3 * likely(painted, "red")


def test_what_no_view_shows_has_all_colours_alike(scene: Scene, empty_scene: Scene):
    imported = imported_scene()
    assert seen_color_shares(imported, imported.objects) is None
    none = seen_color_shares(empty_scene, [])
    assert none is not None
    assert none.shape == (0, len(COLOR_NAMES))
    hidden = scene.move(1, (0.0, 0.0, -100.0))
    shares = seen_color_shares(hidden, hidden.objects)
    assert shares is not None
    assert shares[0].tolist() == pytest.approx([1 / len(COLOR_NAMES) + FLOOR] * len(COLOR_NAMES))
