from dataclasses import replace

import pytest
import torch

from fake_rooms import FakeRooms
from flat_rooms import FlatRooms, oracle
from instok3d.data.batches import make_sample
from instok3d.data.view_sampling import FrameChoice
from instok3d.data.words import ObjectWords
from instok3d.evaluation.method_features import measure_features
from instok3d.evaluation.methods import Cost, FittedScene, Need, Shown
from instok3d.semantics.classes import PHRASES

CLASSES = ("wall", "bed", "sofa")
SAMPLE = replace(
    make_sample(FlatRooms([0], ["easy"]), 0, FrameChoice((5, 11), (8,))),
    words=({k + 1: ObjectWords(name) for k, name in enumerate(CLASSES)},),
)


class Phrases:
    """Texts are directions of their own; says nothing of photos."""

    name, channels = "phrases", len(PHRASES)

    def features(self, images):
        return torch.ones(len(images), self.channels, 4, 4)

    def text(self, texts):
        return torch.eye(self.channels)[[PHRASES.index(text) for text in texts]]

    def crop(self, image):
        raise ValueError("no crops")


class Knowing:
    """Shows the class of each thing, in three channels that a map brings to the phrases."""

    def __init__(self, features: bool = True) -> None:
        self.features = features

    @property
    def needs(self) -> frozenset[Need]:
        return frozenset()

    def fit(self, shown: Shown) -> FittedScene:
        assert shown.views.cam_from_world is None
        groups = oracle(SAMPLE, unit=1.7)(shown.views)
        places = [PHRASES.index(name) for name in CLASSES]
        return FittedScene(
            gaussians=groups.gaussians.scene(0), assignment=None,
            cameras=groups.geometry.cameras.scene(0), cost=Cost(1, 1, 0, 0.0, 77),
            features=groups.assignment[0, :, 1:4].contiguous() if self.features else None,
            feature_map=torch.eye(len(PHRASES))[places].T,
        )  # fmt: skip


def test_a_method_that_knows_the_classes_names_nearly_all_pixels():
    found = measure_features(Knowing(), [SAMPLE], Phrases())
    assert found.source.rooms.accuracy() > 0.95  # Gaussians of a board reach over its border
    assert found.target.rooms.accuracy() > 0.85
    assert found.source.rooms.counts.sum() == 2 * 32 * 32
    assert found.target.lsm.counts.sum() == 32 * 32
    assert found.scalars == [77]
    # One of all directions, of equal lengths: 1 / sqrt of their number.
    assert found.cosines["source"][0] == pytest.approx(len(PHRASES) ** -0.5, abs=0.01)


def test_no_sample_counts_nothing():
    found = measure_features(Knowing(), [], Phrases())
    assert found.scalars == []
    assert found.source.rooms.counts.sum() == 0


def test_what_cannot_be_measured_is_named():
    with pytest.raises(ValueError, match="frames 5,11 has no features"):
        measure_features(Knowing(features=False), [SAMPLE], Phrases())
    two = make_sample(FakeRooms(1, size=32), 0, FrameChoice((6, 10), (8,)))
    with pytest.raises(ValueError, match="scene by scene, got 2"):
        measure_features(Knowing(), [replace(two, names=("a", "b"))], Phrases())
