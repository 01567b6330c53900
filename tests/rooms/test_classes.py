"""The class names: 66 of them, with ScanNet and NYU names that exist."""

import numpy as np

from instok3d.rooms.classes import CLASSES, NYU40, SCANNET20, STUFF
from instok3d.rooms.materials import Maker
from instok3d.rooms.objects import REGISTRY

# The label names of the ScanNet benchmark and of NYU v2, as their authors publish them.
SCANNET20_NAMES = {
    "wall", "floor", "cabinet", "bed", "chair", "sofa", "table", "door", "window", "bookshelf",
    "picture", "counter", "desk", "curtain", "refrigerator", "shower curtain", "toilet", "sink",
    "bathtub", "otherfurniture",
}  # fmt: skip
NYU40_NAMES = {
    "wall", "floor", "cabinet", "bed", "chair", "sofa", "table", "door", "window", "bookshelf",
    "picture", "counter", "blinds", "desk", "shelves", "curtain", "dresser", "pillow", "mirror",
    "floor mat", "clothes", "ceiling", "books", "refrigerator", "television", "paper", "towel",
    "shower curtain", "box", "whiteboard", "person", "night stand", "toilet", "sink", "lamp",
    "bathtub", "bag", "otherstructure", "otherfurniture", "otherprop",
}  # fmt: skip


def test_there_are_66_classes_and_each_name_is_there_once():
    assert len(CLASSES) == len(set(CLASSES)) == 66
    assert set(STUFF) <= set(CLASSES)


def test_maps_go_from_classes_to_names_that_exist():
    assert len(SCANNET20_NAMES) == 20
    assert len(NYU40_NAMES) == 40
    assert set(SCANNET20) <= set(CLASSES)
    assert set(NYU40) <= set(CLASSES)
    assert set(SCANNET20.values()) <= SCANNET20_NAMES
    assert set(NYU40.values()) <= NYU40_NAMES


def test_every_scannet_name_has_a_class():
    assert {SCANNET20.get(name, "otherfurniture") for name in CLASSES} == SCANNET20_NAMES


def test_every_class_has_a_source():
    made = {generate(Maker(np.random.default_rng(0))).name for generate in REGISTRY.values()}
    assert made | {"wall", "floor", "ceiling", "door", "window"} == set(CLASSES)
