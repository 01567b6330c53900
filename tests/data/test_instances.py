import torch

from instok3d.data.instances import instance_ids

MAPS = torch.tensor([[[0, 7, 7], [-1, 7, 3]], [[7, 3, 3], [0, 9, -1]]])


def test_ids_counted_over_all_views():
    # 7: 3 + 1 pixels, 3: 1 + 2, 9: 1.
    assert instance_ids(MAPS).tolist() == [3, 7, 9]
    assert instance_ids(MAPS, min_pixels=3).tolist() == [3, 7]


def test_void_and_ignored_pixels_alone_hold_no_instance():
    assert instance_ids(torch.tensor([[0, -1], [0, 0]])).numel() == 0
