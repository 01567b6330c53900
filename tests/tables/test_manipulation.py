from dataclasses import replace

import numpy as np
import torch

from instok3d.backbones.registry import build_backbone
from instok3d.model.tokenizer import Tokenizer
from instok3d.scene.visibility import BestView, Sight
from instok3d.tables import manipulation
from instok3d.tables.manipulation import TITLES, edited_scenes
from instok3d.tables.trainings import QUICK_BACKBONE, QUICK_SIZES
from made_scene import HEIGHT, WIDTH, made_empty_scene, made_scene, made_tokens

PHOTOS = torch.zeros(2, 3, HEIGHT, WIDTH)


def rows_of(monkeypatch, *scenes) -> list:
    left = iter(scenes)
    monkeypatch.setattr(manipulation, "scene_of_photos", lambda *_: next(left))
    tokenizer = Tokenizer(build_backbone(QUICK_BACKBONE), QUICK_SIZES)
    return edited_scenes(tokenizer, [PHOTOS] * len(scenes))


def test_edits_change_the_object_and_nothing_elsewhere(monkeypatch):
    scene = made_scene(made_tokens())
    monkeypatch.setattr(manipulation, "LEAST_PIXELS", 1)
    (row,) = rows_of(monkeypatch, scene)
    assert len(row) == len(TITLES)
    photo, rendered, alone, removed, moved, inserted = (each.astype(int) for each in row)
    assert not photo.any()
    red = scene.object(1)
    view = red.best_view
    assert view is not None
    x0, y0, x1, y1 = view.bbox
    # Alone it stands on white; the blue blob to the right is not there.
    assert (alone[0] == 255).all()
    assert (alone[:, WIDTH * 3 // 4 :] == 255).all()
    reddish = rendered[(y0 + y1) // 2, (x0 + x1) // 2]
    assert reddish[0] > reddish[2]
    changed = np.abs(removed - rendered).max(axis=2) > 20
    assert changed[y0:y1, x0:x1].any()
    assert not changed[:, WIDTH * 3 // 4 :].any()
    for other in (moved, inserted):
        assert (np.abs(other - rendered).max(axis=2) > 20).any()
    assert (np.abs(moved - removed).max(axis=2) > 20).any()


def test_no_room_and_rooms_without_a_thing_give_no_row(monkeypatch):
    assert rows_of(monkeypatch) == []
    assert rows_of(monkeypatch, made_empty_scene()) == []
    monkeypatch.setattr(manipulation, "MOST", 0.0)
    assert rows_of(monkeypatch, made_scene(made_tokens())) == []


def test_the_largest_thing_that_no_border_cuts_is_chosen(monkeypatch):
    monkeypatch.setattr(manipulation, "LEAST_PIXELS", 1)
    monkeypatch.setattr(manipulation, "MOST", 1.0)
    scene = made_scene(made_tokens())
    first, second = scene.objects
    cut, whole = BestView(0, (0, 3, 9, 9), 40), BestView(0, (1, 1, 9, 9), 20)
    scene = replace(scene, objects=(
        replace(first, sight=Sight((0,), cut)), replace(second, sight=Sight((0,), whole)),
    ))  # fmt: skip
    assert manipulation._largest_thing(scene) == scene.objects[1]
    monkeypatch.setattr(manipulation, "LEAST_PIXELS", 21)
    assert manipulation._largest_thing(scene) is None
