from dataclasses import replace

import pytest
import torch

from flat_rooms import FlatRooms
from instok3d.baselines.context_masks import context_masks
from instok3d.data.batches import make_sample
from instok3d.data.sample import Sample
from instok3d.data.view_sampling import FrameChoice
from instok3d.tables.kept_masks import kept_masks

SAMPLE = make_sample(FlatRooms([0], ["easy"]), 0, FrameChoice((5, 7), (8,)))


@pytest.fixture
def asked() -> list[str]:
    return []


@pytest.fixture
def masks_of(asked):
    made = context_masks("degraded", "none")

    def counted(sample: Sample):
        asked.append(sample.names[0])
        return made(sample)

    return counted


def test_masks_are_made_once_and_stay_the_same(masks_of, asked, tmp_path):
    first = kept_masks(masks_of, tmp_path / "masks")(SAMPLE)
    again = kept_masks(masks_of, tmp_path / "masks")(SAMPLE)
    assert torch.equal(first, context_masks("degraded", "none")(SAMPLE))
    assert torch.equal(first, again)
    assert first.dtype == again.dtype
    assert len(asked) == 1


def test_other_names_photos_and_instances_are_other_masks(masks_of, asked, tmp_path):
    kept = kept_masks(masks_of, tmp_path)
    context, instances = SAMPLE.context, SAMPLE.context_instances
    for sample in (
        SAMPLE,
        replace(SAMPLE, names=("another",)),
        replace(SAMPLE, context=replace(context, images=1 - context.images)),
        replace(SAMPLE, context_instances=instances + 1),
    ):
        kept(sample)
    assert len(asked) == 4


def test_a_damaged_file_is_named(masks_of, tmp_path):
    kept_masks(masks_of, tmp_path)(SAMPLE)
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:-9])
    with pytest.raises(ValueError, match=rf"{file.name} is damaged .*; remove it, the masks are"):
        kept_masks(masks_of, tmp_path)(SAMPLE)
