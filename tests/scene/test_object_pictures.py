from dataclasses import replace

import numpy as np
import pytest
import torch

from imported_scene import imported_scene
from instok3d.scene.object_pictures import object_in_photo, object_picture, window_around
from instok3d.scene.scene import Scene
from instok3d.scene.visibility import BestView


@pytest.mark.parametrize(
    ("bbox", "window"),
    [
        ((41, 31, 59, 39), (37.5, 25, 25, 20)),  # a quarter of the view at least
        ((40, 20, 80, 60), (27.5, 14, 65, 52)),  # 40 and twice 6 of 80 pixels of height
        ((0, 70, 10, 80), (0, 60, 25, 20)),  # moved into the view
        ((0, 0, 100, 10), (0, 0, 100, 80)),  # no more than the view
    ],
    ids=["small", "large", "at the corner", "as wide as the view"],
)
def test_the_window_is_about_the_object_and_within_the_view(bbox, window: tuple[float, ...]):
    found = window_around(BestView(0, bbox, 1), height=80, width=100)
    assert tuple(vars(found).values()) == pytest.approx(window)


def test_the_object_alone_is_the_view_enlarged(scene: Scene):
    item = scene.objects[0]
    best = item.best_view
    assert best is not None
    whole = replace(item, sight=replace(item.sight, best_view=replace(best, bbox=(0, 0, 32, 24))))
    view = object_picture(scene, whole)
    assert (view[0, -1] == 255).all()
    corner = replace(item, sight=replace(item.sight, best_view=replace(best, bbox=(0, 6, 1, 18))))
    window = window_around(BestView(best.view, (0, 6, 1, 18), 1), 24, 32)
    assert window.left == 0
    enlarged = object_picture(scene, corner).astype(float)
    # Its pixel (x, y) shows the point (left, top) + (x, y) window / view of the view.
    y, x = np.mgrid[2:22, 2:30]
    rows = np.floor(window.top + (y + 0.5) * window.height / 24).astype(int)
    columns = np.floor((x + 0.5) * window.width / 32).astype(int)
    assert np.abs(enlarged[y, x] - view[rows, columns]).mean() < 12
    assert np.abs(enlarged - view).mean() > 24


def test_in_the_photo_the_object_is_outlined_and_all_else_faded(scene: Scene):
    item = scene.objects[0]
    best = item.best_view
    assert best is not None
    whole = replace(item, sight=replace(item.sight, best_view=replace(best, bbox=(0, 0, 32, 24))))
    dark = replace(scene, photos=torch.zeros_like(scene.photos))
    picture = object_in_photo(dark, whole)
    assert picture is not None
    own = item.sight.masks[item.visible_in.index(best.view)].mask().numpy()
    beside = np.zeros_like(own)
    beside[1:] |= own[:-1]
    beside[:-1] |= own[1:]
    beside[:, 1:] |= own[:, :-1]
    beside[:, :-1] |= own[:, 1:]
    assert (picture[own] == 0).all()
    assert (picture[beside & ~own] == list(bytes.fromhex(item.color[1:]))).all()
    assert (picture[~beside & ~own] == 191).all()  # three quarters of the way to white


def test_of_a_scene_without_photos_there_is_none():
    scene = imported_scene()
    assert object_in_photo(scene, scene.objects[0]) is None
    assert object_picture(scene, scene.objects[0]).min() < 200
