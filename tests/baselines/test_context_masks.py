import sys
from dataclasses import replace

import pytest
import torch

from flat_rooms import FlatRooms, oracle
from instok3d.baselines.context_masks import context_masks
from instok3d.data.batches import make_sample
from instok3d.data.sample import photos_only
from instok3d.data.view_sampling import FrameChoice
from instok3d.types import Geometry, Views

SAMPLE = make_sample(FlatRooms([0], ["easy"]), 0, FrameChoice((5, 7, 9, 11), (8,)))
TRUE = SAMPLE.context_instances[0]


def test_true_masks_with_true_ids_are_those_of_the_data():
    assert torch.equal(context_masks("true", "true-ids")(SAMPLE), TRUE)
    assert len(context_masks("true", "none")(SAMPLE).unique()) == 12


def test_tracking_by_true_depth_finds_the_true_ids_again():
    found = context_masks("true", "true-depth")(SAMPLE)
    assert [len(found[name == TRUE].unique()) for name in (1, 2, 3)] == [1, 1, 1]


def test_predicted_depth_is_that_of_the_model_of_bare_photos():
    seen: list[Views] = []

    def geometry_of(views: Views) -> Geometry:
        seen.append(views)
        return oracle(SAMPLE, unit=1.7)(views).geometry

    nowhere = replace(SAMPLE, context=replace(SAMPLE.context, depths=torch.zeros(1, 4, 32, 32)))
    found = context_masks("true", "predicted-depth", geometry_of=geometry_of)(nowhere)
    assert torch.equal(found, context_masks("true", "true-depth")(SAMPLE))
    assert seen[0].cam_from_world is seen[0].depths is seen[0].intrinsics is None
    with pytest.raises(ValueError, match="needs a geometry network"):
        context_masks("true", "predicted-depth")


def test_flow_sees_photos_alone():
    bare = replace(SAMPLE, context=photos_only(SAMPLE.context))
    found = context_masks("degraded", "flow2d")(bare)
    own = context_masks("degraded", "none")(bare)
    assert torch.equal(found > 0, own > 0)
    assert len(found.unique()) < len(own.unique())


def test_flow_is_refused_at_once_without_opencv(monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'instok3d\[flow\]'"):
        context_masks("true", "flow2d")


def test_degraded_masks_depend_on_the_seed_and_the_name_of_the_sample():
    first, again = (context_masks("degraded", "none")(SAMPLE) for _ in range(2))
    assert torch.equal(first, again)
    assert not torch.equal(first, context_masks("true", "none")(SAMPLE))
    other = context_masks("degraded", "none", seed=1)(SAMPLE)
    elsewhere = context_masks("degraded", "none")(replace(SAMPLE, names=("another",)))
    assert not torch.equal(first, other)
    assert not torch.equal(first, elsewhere)


def test_degraded_masks_have_no_true_ids():
    with pytest.raises(ValueError, match="choose --tracker true-depth"):
        context_masks("degraded", "true-ids")
