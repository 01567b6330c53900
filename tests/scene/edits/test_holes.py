"""The holes that removals leave: marked in the log, and seen from any camera."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import save

import instok3d
from edited_scenes import assert_bit_equal
from imported_scene import imported_scene
from instok3d.cli import main
from instok3d.scene.edits.holes import alphas_of
from instok3d.scene.edits.operations import Remove
from instok3d.scene.paths import orbit
from instok3d.scene.scene import Scene


@pytest.fixture
def bare(scene: Scene) -> Scene:
    """The two blobs without the void behind them, so that a removal opens the picture."""
    rest = scene.gaussians.rows(slice(0, scene.objects[-1].gaussian_range[0] + 8))
    return replace(scene, gaussians=rest)


def test_the_hole_is_where_the_object_was_and_nothing_is_now(bare: Scene):
    ids = bare.render(ids=True).ids
    assert ids is not None
    removed = bare.remove(1, claim=True)
    hole = removed.holes()
    assert 100 < int(hole.sum()) < 600
    assert float((hole[ids == 1]).float().mean()) > 0.9
    assert not hole[ids == 3].any()
    assert (removed.render().alphas[hole] < 0.5).all()
    assert not removed.undo().holes().any()
    assert not bare.holes().any()


def test_a_background_that_shows_through_is_no_hole(scene: Scene):
    removed = scene.remove(1)
    hole = removed.holes()
    alphas = removed.render().alphas
    assert not hole[alphas >= 0.5].any()


def test_a_hole_is_seen_from_any_camera_and_closes_when_something_fills_it(bare: Scene):
    cameras = orbit(bare, 3)
    removed = bare.remove(1)
    assert removed.holes(cameras, 24, 32).flatten(1).any(dim=1).all()
    again = removed.insert(bare, 1, bare.object(1).centroid, scale=1.0)
    assert again.holes(cameras, 24, 32).sum() < 0.5 * removed.holes(cameras, 24, 32).sum()
    assert removed.hide(3).holes([1]).sum() == removed.holes([1]).sum()


def test_what_was_hidden_leaves_no_hole(bare: Scene):
    assert not bare.hide(1).remove(1, claim=True).holes().any()


def test_the_log_keeps_the_hole_and_says_its_share(tmp_path: Path, bare: Scene, capsys):
    removed = bare.remove(1, claim=True)
    assert removed.history is not None
    edit = removed.history.edits[0]
    assert isinstance(edit, Remove)
    assert edit.hole is not None
    assert torch.equal(torch.stack([each.mask() for each in edit.hole]), removed.holes())
    share = f"{removed.holes().float().mean():.2%}"
    assert removed.edits == (f"remove object#1, which leaves a hole in {share} of the views",)
    removed.save(tmp_path / "room.itk")
    line = json.loads((tmp_path / "room.itk/edits.jsonl").read_text().splitlines()[1])
    assert line["hole"] == [each.to_json() for each in edit.hole]
    assert not (tmp_path / "room.itk/edits").exists()
    loaded = instok3d.load(tmp_path / "room.itk")
    assert_bit_equal(loaded, removed)
    assert torch.equal(loaded.holes(), removed.holes())
    assert main(["edit", str(tmp_path / "room.itk"), "log"]) == 0
    assert f"a hole in {share} of the views" in capsys.readouterr().out


def test_a_log_of_version_1_with_a_file_of_masks_is_read(tmp_path: Path, bare: Scene):
    removed, path = bare.remove(1, claim=True), tmp_path / "room.itk"
    removed.save(path)
    header, line = map(json.loads, (path / "edits.jsonl").read_text().splitlines())
    data = save({"masks": removed.holes()})
    name = f"{hashlib.sha256(data).hexdigest()}.safetensors"
    (path / "edits").mkdir()
    (path / "edits" / name).write_bytes(data)
    lines = [header | {"version": 1}, line | {"hole": name}]
    (path / "edits.jsonl").write_text("\n".join(map(json.dumps, lines)) + "\n")
    assert_bit_equal(instok3d.load(path), removed)


def test_the_command_hatches_holes(tmp_path: Path, bare: Scene):
    room, plain, marked = tmp_path / "room.itk", tmp_path / "a", tmp_path / "b"
    removed = bare.remove(1, claim=True)
    removed.save(room)
    assert main(["render", str(room), "-o", str(plain)]) == 0
    assert main(["render", str(room), "-o", str(marked), "--holes"]) == 0
    hole = removed.holes()[0].numpy()
    from numpy import asarray
    from PIL import Image

    one, two = (asarray(Image.open(folder / "000.png")) for folder in (plain, marked))
    assert (one[~hole] == two[~hole]).all()
    assert 0.3 < (two[hole] == (255, 0, 255)).all(axis=1).mean() < 0.7
    assert main(["render", str(room), "-o", str(tmp_path / "c"), "--holes", "--only", "3"]) == 2


def test_without_views_cameras_must_be_given():
    removed = imported_scene().remove(5, claim=True)
    with pytest.raises(ValueError, match="give cameras"):
        removed.holes()
    assert removed.holes(orbit(removed, 2), 24, 32).shape == (2, 24, 32)


def test_nothing_at_all_is_open(bare: Scene):
    nothing = bare.gaussians.rows(slice(0, 0))
    assert not alphas_of(nothing, bare.near_far, bare.cameras, 4, 5).any()
    assert alphas_of(nothing, bare.near_far, bare.cameras.views([]), 4, 5).shape == (0, 4, 5)
