import math
from dataclasses import replace

import pytest
import torch

from instok3d.baselines.density import Change
from instok3d.baselines.identity import IdentityEncodings, IdentitySettings
from instok3d.baselines.instances import Instances
from instok3d.refinement.parameters import GaussianParameters

COLUMNS = torch.tensor([[[0, 1], [2, 0]]])
INSTANCES = Instances(torch.tensor([4, 9]), COLUMNS)
FLAT = IdentitySettings(weight_3d=0.0)


def encodings(count: int, settings: IdentitySettings = FLAT) -> IdentityEncodings:
    return IdentityEncodings(INSTANCES, count, settings, seed=0)


def test_ids_are_columns_and_anything_else_is_the_void():
    assert INSTANCES.num_columns == 3
    assert INSTANCES.column_of(torch.tensor([9, 4, 0, -1, 5, 99])).tolist() == [1, 0, 2, 2, 2, 2]
    none = Instances(torch.zeros(0, dtype=torch.int64), COLUMNS)
    assert none.column_of(torch.tensor([4, 0])).tolist() == [0, 0]


def test_a_picture_that_says_nothing_costs_one_at_any_number_of_classes():
    own = encodings(3)
    with torch.no_grad():
        own.weight.zero_()
    # Cross entropy ln 3 over three equal classes, divided by ln 3.
    assert float(own.loss(torch.ones(16, 2, 2), 0, 1, torch.zeros(3, 3))) == pytest.approx(1.0)


def test_the_classifier_is_linear_in_the_encodings():
    own = encodings(2, replace(FLAT, channels=2))
    with torch.no_grad():
        own.weight.copy_(torch.tensor([[1.0, 0], [0, 2], [0, 0]]))
        own.bias.copy_(torch.tensor([0.0, 0, 5]))
    assert own.classified(torch.tensor([3.0, 4])).tolist() == [3, 8, 5]


def test_neighbours_of_other_classes_cost_and_equal_ones_do_not():
    settings = IdentitySettings(channels=1, weight_2d=0.0, weight_3d=3.0, neighbors=2)
    own = encodings(2, settings)
    means, maps = torch.tensor([[0.0, 0, 0], [1, 0, 0]]), torch.zeros(1, 2, 2)
    with torch.no_grad():
        own.weight.copy_(torch.tensor([[1.0], [0], [0]]))
        own.encodings.copy_(torch.tensor([[2.0], [2.0]]))
    assert float(own.loss(maps, 0, 0, means)) == pytest.approx(0.0, abs=1e-6)
    with torch.no_grad():
        own.encodings.copy_(torch.tensor([[math.log(2)], [0.0]]))
    # p = (2, 1, 1) / 4 and q = (1, 1, 1) / 3; each has itself and the other as neighbours.
    p, q = [0.5, 0.25, 0.25], [1 / 3] * 3
    both = sum(a * math.log(a / b) for a, b in zip(p, q, strict=True))
    both += sum(b * math.log(b / a) for a, b in zip(p, q, strict=True))
    assert float(own.loss(maps, 0, 0, means)) == pytest.approx(both / 4, abs=1e-6)
    assert float(own.loss(maps, 0, 1, means)) == 0.0  # every fifth step


def test_added_gaussians_have_the_encoding_of_their_source():
    own = encodings(3)
    before = own.encodings.detach().clone()
    source = torch.tensor([2, 0, 0])
    points = torch.zeros(3, 3)
    parameters = GaussianParameters(
        points, points, torch.zeros(3, 4), points[:, 0], points[:, None], points[:, None]
    )
    change = Change(parameters, source, torch.tensor([False, False, True]))
    assert own.follow(torch.arange(3), change).tolist() == [0, 1, 2]
    assert torch.equal(own.encodings.detach(), before[source])
    own.encodings.sum().backward()
    own.step()
    assert (own.encodings.detach() < before[source]).all()
