import math

import pytest
import torch

from instok3d.baselines.instances import Instances
from instok3d.baselines.object_labels import FrozenLabels, anchors_of

INSTANCES = Instances(torch.tensor([4, 9]), torch.tensor([[[0, 2], [2, 2]], [[2, 2], [2, 2]]]))


def test_points_of_one_label_in_one_cell_share_an_anchor():
    points = torch.tensor([[0.1, 0.1, 0.1], [0.9, 0.2, 0.3], [0.5, 0.5, 0.5], [-0.1, 0.1, 0.1]])
    anchors, labels = anchors_of(points, torch.tensor([1, 1, 0, 1]), 1.0)
    assert len(labels) == 3
    assert anchors[0] == anchors[1]
    assert labels[anchors].tolist() == [1, 1, 0, 1]
    assert len(anchors_of(torch.zeros(0, 3), torch.zeros(0, dtype=torch.long), 1.0)[1]) == 0


def test_composited_labels_are_logits_and_the_void_asks_nothing():
    labels = FrozenLabels(torch.tensor([0, 1, 2]), INSTANCES, 0.1)
    assert labels.features().tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    maps = torch.zeros(3, 2, 2)
    maps[0, 0, 0] = 1.0  # the only pixel of a thing, all of it of the right one
    maps[1, 1, 1] = 1.0
    expected = -0.1 * math.log(math.e / (math.e + 2))
    assert float(labels.loss(maps, 0, 0, torch.zeros(0, 3))) == pytest.approx(expected)
    assert float(labels.loss(maps, 1, 0, torch.zeros(0, 3))) == 0.0
