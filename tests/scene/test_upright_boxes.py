"""Upright boxes along the walls of a room."""

import math
from dataclasses import replace

import pytest
import torch

from instok3d.geometry.moving import quat_about
from instok3d.scene.boxes import OrientedBox
from instok3d.scene.scene import Scene
from instok3d.scene.upright_boxes import level_axes, upright_boxes
from instok3d.scene.vertical import Vertical


def test_level_axes_are_those_of_the_objects_boxes(scene: Scene):
    # Two boxes, turned by 30 degrees about up (z) and by 30 + 90.
    boxes = [
        OrientedBox(
            (0.0, 0.0, 0.0), (3.0, 1.0, 2.0), quat_about([0.0, 0.0, 1.0], math.radians(angle))
        )
        for angle in (30, 120)
    ]
    objects = [replace(scene.objects[0], obb=box) for box in boxes]
    axes = level_axes(objects, (0.0, 0.0, 1.0))
    torch.testing.assert_close(axes.T @ axes, torch.eye(3, dtype=torch.float64))
    assert float(torch.linalg.det(axes)) == pytest.approx(1)
    assert axes[:, 2].tolist() == [0, 0, 1]
    angle = math.degrees(math.atan2(float(axes[1, 0]), float(axes[0, 0]))) % 90
    assert angle == pytest.approx(30, abs=1e-6)


def test_without_objects_there_are_axes_but_no_boxes(empty_scene: Scene):
    assert level_axes([], (0.0, -1.0, 0.0)).shape == (3, 3)
    assert upright_boxes(empty_scene, empty_scene.objects).low.shape == (0, 3)


def test_boxes_stand_along_up_and_reach_as_far_as_the_world_boxes(scene: Scene):
    upright = replace(scene, vertical=Vertical((0.0, -1.0, 0.0), "given", 1.0))
    boxes = upright_boxes(upright, upright.objects)
    for row, item in enumerate(upright.objects):
        # Up is -y: least along up is the negative of the largest y.
        assert float(boxes.low[row, 2]) == pytest.approx(-item.aabb.max[1], abs=1e-5)
        assert float(boxes.high[row, 2]) == pytest.approx(-item.aabb.min[1], abs=1e-5)
    assert (boxes.low <= boxes.high).all()
