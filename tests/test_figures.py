"""The script that makes the pictures of edits, on a small scene."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

pytest.importorskip("embreex", reason="what is inserted comes from generated rooms: '.[rooms]'")

from instok3d.geometry.cameras import project, transform_points
from instok3d.scene.scene import Scene
from made_scene import made_scene, made_tokens

ROOT = Path(__file__).resolve().parents[1]
EDITS = runpy.run_path(str(ROOT / "docs/pictures/edits.py"))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return made_scene(made_tokens())


def pixel_of(scene: Scene, which: int) -> tuple[int, int]:
    ids = scene.render([0], ids=True).ids
    assert ids is not None
    row, column = (ids[0] == which).nonzero().float().median(dim=0).values.long().tolist()
    return row, column


def test_the_point_at_a_pixel_is_seen_in_the_middle_of_it(scene: Scene):
    point = torch.tensor(EDITS["point_at"](scene, 1, (7, 11)))
    seen = transform_points(scene.cameras.cam_from_world[1], point[None])
    pixel = project(seen, scene.cameras.intrinsics[1])
    torch.testing.assert_close(pixel[0], torch.tensor([11.5, 7.5]), atol=1e-3, rtol=0)


def test_each_picture_of_a_row_shows_another_edit(scene: Scene):
    handle = EDITS["Handle"](0, pixel_of(scene, 1))
    assert handle.find(scene) == 1
    row = EDITS["edited"](
        scene,
        scene,
        EDITS["Edits"](handle, (20, 20), EDITS["Handle"](0, pixel_of(scene, 3)), (4, 4)),
    )
    assert len(row) == len(EDITS["TITLES"])
    assert {picture.shape for picture in row} == {(EDITS["SIDE"], EDITS["SIDE"], 3)}
    assert len({picture.tobytes() for picture in row}) == len(row)
    assert row[1][0, -1].tolist() == [255, 255, 255]


def test_pictures_are_enlarged_pixel_by_pixel():
    (large,) = EDITS["enlarged"](np.arange(12, dtype=np.uint8).reshape(1, 2, 2, 3))
    assert large[:2, :2].reshape(4, 3).tolist() == [[0, 1, 2]] * 4
    assert large.shape == (4, 4, 3)


def test_up_is_the_normal_of_the_floor_towards_the_camera(scene: Scene):
    handle = EDITS["Handle"](0, pixel_of(scene, 1))
    item = scene.object(1)
    up = torch.tensor(EDITS["upright"](scene, handle).vertical.up)
    to_camera = -torch.tensor(item.obb.center)  # the first camera stands in the origin
    assert float(up @ to_camera) > 0
    torch.testing.assert_close(up.norm(), torch.tensor(1.0))


@pytest.mark.parametrize("name", ["demo.jpg", "edits.jpg"])
def test_pictures_of_the_pages_are_small(name: str):
    assert (ROOT / "docs/pictures" / name).stat().st_size < 200_000
