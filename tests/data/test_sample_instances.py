import torch

from instok3d.data.instances import (
    ignore_small,
    instance_ids,
    instance_masks,
    masks_to_ids,
    relabel,
)

MAPS = torch.tensor([[[0, 7, 7], [-1, 7, 3]], [[7, 3, 3], [0, 9, -1]]])


def test_ids_counted_over_all_views():
    # 7: 3 + 1 pixels, 3: 1 + 2, 9: 1.
    assert instance_ids(MAPS).tolist() == [3, 7, 9]
    assert instance_ids(MAPS, min_pixels=3).tolist() == [3, 7]
    assert instance_ids(torch.zeros(2, 2, dtype=torch.long)).numel() == 0


def test_masks_and_back():
    masks = instance_masks(MAPS, instance_ids(MAPS))
    assert masks.shape == (3, 2, 2, 3)
    assert torch.equal(masks_to_ids(masks), relabel(MAPS).clamp_min(0))
    assert not masks_to_ids(masks[:0]).any()


def test_relabel_closes_holes_and_keeps_void_and_ignored():
    expected = [[[0, 2, 2], [-1, 2, 1]], [[2, 1, 1], [0, 3, -1]]]
    assert relabel(MAPS).tolist() == expected


def test_small_instances_are_ignored():
    assert (ignore_small(MAPS, min_pixels=2) == -1).sum() == 3
    assert torch.equal(ignore_small(MAPS, min_pixels=1), MAPS)
