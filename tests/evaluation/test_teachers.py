from dataclasses import dataclass, replace

import pytest
import torch
from torch import Tensor

from fake_rooms import FakeRooms
from instok3d.data.scenes import SceneFrames
from instok3d.data.words import ObjectWords
from instok3d.evaluation.teachers import measure_teacher, nearest_class, true_classes
from instok3d.semantics.classes import LSM_CLASSES, ROOM_CLASSES

WORDS = {1: ObjectWords("armchair"), 2: ObjectWords("rug"), 3: ObjectWords("submarine")}


@pytest.fixture
def scene() -> SceneFrames:
    """Two frames with an armchair, a rug and a thing that no room has; walls have no words."""
    found = FakeRooms(1, size=32).frames(0, [0, 8])
    return replace(found, words=WORDS)


@dataclass
class ToldTeacher:
    """Knows the classes of some pictures; says one word where it is told to."""

    scene: SceneFrames
    always: str = ""
    name: str = "told"
    channels: int = len(ROOM_CLASSES)

    def features(self, images: Tensor) -> Tensor:
        pictures = self.scene.images.permute(0, 3, 1, 2).float() / 255
        frame = next(k for k, each in enumerate(pictures) if each.equal(images[0]))
        places = true_classes(self.scene.instances, self.scene.words)[0, frame].clamp_min(0)
        if self.always:
            places = torch.full_like(places, ROOM_CLASSES.index(self.always))
        return torch.eye(self.channels)[places].movedim(-1, 0)[None]

    def text(self, texts) -> Tensor:
        return torch.eye(self.channels)[[ROOM_CLASSES.index(text) for text in texts]]

    def crop(self, image: Tensor) -> Tensor:
        raise ValueError("told knows no crops")


def test_true_classes_of_pixels(scene: SceneFrames):
    rooms, lsm = true_classes(scene.instances, scene.words)
    ids = scene.instances
    assert (rooms[ids == 1] == ROOM_CLASSES.index("armchair")).all()
    assert (lsm[ids == 1] == LSM_CLASSES.index("chair")).all()
    assert (lsm[ids == 2] == LSM_CLASSES.index("other")).all()
    assert (rooms[ids == 3] == -1).all()
    assert (lsm[ids == 3] == LSM_CLASSES.index("other")).all()
    assert (rooms[ids == 0] == -1).all()
    assert (lsm[ids == 0] == -1).all()


def test_the_class_of_the_data_set_goes_before_the_word():
    words = {1: ObjectWords("office chair", nyu40="chair"), 2: ObjectWords("couch")}
    rooms, lsm = true_classes(torch.tensor([[[1, 2]]]), words)
    assert lsm.tolist() == [[[LSM_CLASSES.index("chair"), LSM_CLASSES.index("other")]]]
    assert rooms.tolist() == [[[-1, -1]]]


def test_a_teacher_that_is_always_right(scene: SceneFrames):
    quality = measure_teacher(ToldTeacher(scene), [scene])
    assert quality.rooms.mean_iou() == quality.rooms.accuracy() == 1
    ids = scene.instances
    assert int(quality.rooms.counts.sum()) == int(((ids == 1) | (ids == 2)).sum())
    assert "| armchair | 1.000 |" in quality.table()


def test_a_teacher_that_always_says_one_word(scene: SceneFrames):
    quality = measure_teacher(ToldTeacher(scene, always="chair"), [scene])
    ids, ious = scene.instances, quality.lsm.ious()
    share = float((ids == 1).sum() / (ids > 0).sum())
    assert quality.lsm.accuracy() == pytest.approx(share)
    assert ious["chair"] == pytest.approx(share)
    assert ious["other"] == quality.rooms.mean_iou() == 0


def test_no_scene_has_no_figures(scene: SceneFrames):
    table = measure_teacher(ToldTeacher(scene), []).table()
    assert "| LSM-8 | nan | nan | nan |" in table


def test_coarse_features_are_interpolated():
    features = torch.tensor([[[[1.0, 0.0]], [[0.0, 1.0]]]])
    assert nearest_class(features, torch.eye(2), (2, 4)).tolist() == [[[0, 0, 1, 1]] * 2]
