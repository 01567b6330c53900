"""Holes filled with the planes around them: a true invention, exact to undo, and said to be one."""

import json
import warnings
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import instok3d
from corner_scene import BALL, FLOOR, TABLE, WALL, corner_scene
from edited_scenes import assert_bit_equal, assert_consistent
from imported_scene import imported_scene
from instok3d.cli import main
from instok3d.formats.statements import scene_comments
from instok3d.scene.edits.certify import certify
from instok3d.scene.edits.disclosure import statement
from instok3d.scene.edits.operations import Remove
from instok3d.scene.scene import Scene


@pytest.fixture(scope="module")
def corner() -> Scene:
    return corner_scene()


@pytest.fixture(scope="module")
def filled(corner: Scene) -> Scene:
    return corner.remove(BALL, claim=True, fill="plane")


def test_floor_and_wall_go_on_behind_what_was_removed(corner: Scene, filled: Scene):
    hole = corner.remove(BALL).holes()
    truth = corner_scene(hidden=True).remove(BALL).render()
    assert hole.sum() > 200
    assert not filled.holes().any()
    pictures = filled.render()
    assert (pictures.alphas[hole] > 0.9).all()
    off = (pictures.colors - truth.colors).abs().amax(1)
    assert float(off[hole].mean()) < 0.02
    assert float(off[~hole].mean()) < 0.005
    assert float(((pictures.depths - truth.depths).abs() / truth.depths)[hole].mean()) < 0.01


def test_what_is_invented_belongs_to_the_surface_that_it_extends(corner: Scene, filled: Scene):
    assert_consistent(filled, sight=True)
    assert [item.id for item in filled.objects] == [FLOOR, WALL]
    ids, before = filled.render(ids=True).ids, corner.render(ids=True).ids
    truth = corner_scene(hidden=True).remove(BALL).render(ids=True).ids
    assert ids is not None and before is not None and truth is not None  # noqa: PT018
    assert float((ids == truth)[before == BALL].float().mean()) > 0.9
    for item in filled.objects:
        assert item.num_gaussians > corner.object(item.id).num_gaussians


@pytest.mark.filterwarnings("ignore:no flat surface")
def test_the_log_of_a_fill_has_the_hole_of_the_removal_alone(corner: Scene):
    """The fill finds the hole from its own pictures, which have maps too."""
    for scene, is_seen in ((corner, True), (corner.hide(WALL), True), (corner.hide(BALL), False)):
        alone, filled = (removal(scene.remove(BALL, claim=True, fill=f)) for f in (None, "plane"))
        assert alone.hole == filled.hole
        assert torch.equal(alone.claimed, filled.claimed)
        assert any(each.mask().any() for each in alone.hole or ()) == is_seen


def removal(scene: Scene) -> Remove:
    assert scene.history is not None
    edit = scene.history.edits[-1]
    assert isinstance(edit, Remove)
    return edit


def test_a_table_top_does_not_grow_into_the_hole_before_it():
    corner = corner_scene(table=True)
    assert TABLE in [item.id for item in corner.objects]
    filled = corner.remove(BALL, fill="plane")
    hole = corner.remove(BALL).holes()
    truth = corner_scene(table=True, hidden=True).remove(BALL).render()
    green = filled.render().colors[:, 1] - filled.render().colors[:, 0] > 0.3
    expected = truth.colors[:, 1] - truth.colors[:, 0] > 0.3
    assert (green & ~expected & hole).sum() < 0.05 * hole.sum()
    assert not filled.holes().any()


def test_undo_is_exact_and_the_log_gives_the_same_again(
    tmp_path: Path, corner: Scene, filled: Scene
):
    assert_bit_equal(filled.undo(), corner)
    assert_bit_equal(filled.undo().redo(), filled)
    assert_bit_equal(corner.remove(BALL, claim=True, fill="plane"), filled)
    filled.save(tmp_path / "room.itk")
    loaded = instok3d.load(tmp_path / "room.itk")
    assert_bit_equal(loaded, filled)
    assert_bit_equal(loaded.undo(), corner)
    assert not loaded.holes().any()


def test_nothing_changes_outside_of_what_was_touched(corner: Scene, filled: Scene):
    found = certify(corner, filled, corner.cameras, corner.height, corner.width)
    assert found.outside == 0
    assert found.new > 0


def test_every_statement_says_how_much_was_invented(filled: Scene):
    count = filled.provenance.invented
    assert filled.history is not None
    edit = filled.history.edits[0]
    assert isinstance(edit, Remove)
    assert edit.invented is not None
    assert count == len(edit.invented.means) > 50
    assert f"{count} invented Gaussians" in filled.edits[0]
    assert f"1 operation, {count} Gaussians invented" in "\n".join(scene_comments(filled))
    assert f"{count} of its Gaussians were invented" in statement(filled)
    twice = filled.remove(WALL, fill="plane")
    assert twice.provenance.invented >= count
    assert filled.undo().provenance.invented == 0
    assert "invented" not in statement(filled.undo())


def test_the_command_fills_only_where_it_is_told_to(tmp_path: Path, corner: Scene, capsys):
    room = tmp_path / "room.itk"
    corner.save(room)
    said = tmp_path / "said.txt"
    assert main(["edit", str(room), "remove", str(BALL), "-o", str(tmp_path / "bare.itk")]) == 0
    assert instok3d.load(tmp_path / "bare.itk").provenance.invented == 0
    line = ["edit", str(room), "remove", str(BALL), "--fill", "plane", "--disclose", str(said)]
    assert main([*line, "--certify"]) == 0
    assert "invented" in said.read_text()
    header = json.loads((room / "edits.jsonl").read_text().splitlines()[1])
    assert header["invented"].endswith(".safetensors")
    capsys.readouterr()
    assert main(["info", str(room)]) == 0
    assert "Gaussians invented" in capsys.readouterr().out
    assert main(["edit", str(room), "hide", "1", "--fill", "plane"]) == 2


def test_a_fill_needs_views_and_a_flat_surface(scene: Scene):
    with pytest.raises(ValueError, match="has no input views"):
        imported_scene().remove(5, fill="plane")
    with pytest.raises(ValueError, match="fill must be 'plane'"):
        scene.remove(1, fill="sphere")
    alone = scene.only(1)
    with pytest.warns(UserWarning, match="no flat surface"):
        nothing = alone.remove(1, fill="plane")
    assert nothing.provenance.invented == 0
    assert nothing.objects == ()


def test_a_hidden_object_leaves_nothing_to_fill(corner: Scene):
    with pytest.warns(UserWarning, match="no flat surface"):
        assert corner.hide(BALL).remove(BALL, fill="plane").provenance.invented == 0


def test_what_is_invented_is_never_hidden(corner: Scene):
    shown = corner.hide(WALL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        filled = shown.remove(BALL, fill="plane")
    wall = next(item for item in filled.objects if item.id == WALL)
    assert wall.num_gaussians == corner.object(WALL).num_gaussians


def test_damaged_inventions_are_refused(tmp_path: Path, filled: Scene):
    assert filled.history is not None
    edit = filled.history.edits[0]
    assert isinstance(edit, Remove)
    assert edit.invented is not None
    far = replace(edit.invented, anchor_index=edit.invented.anchor_index + 10_000)
    history = filled.history.undo().done(edit)
    with pytest.raises(ValueError, match="anchor_index up to"):
        history.undo().done(replace(edit, invented=far))
