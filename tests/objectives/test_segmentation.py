from itertools import permutations
from math import log

import pytest
import torch
from torch.nn import functional

from instok3d.objectives.matching import Pairs
from instok3d.objectives.segmentation import segmentation_loss


def some_maps(rng, *, batch=2, views=3, groups=5, size=8) -> torch.Tensor:
    logits = 2 * torch.randn(batch, views, groups + 1, size, size, generator=rng)
    return logits.softmax(dim=2)[:, :, :-1]


def some_instances(rng, *, batch=2, views=3, size=8, most=4) -> torch.Tensor:
    return torch.randint(0, most, (batch, views, size, size), generator=rng)


def test_bce_and_dice_by_hand():
    # One group, one instance on 2 of 4 pixels, map 0.5 everywhere.
    # BCE = log 2. Dice = 1 - (2 * 1 + 1) / (2 + 2 + 1) = 0.4.
    maps = torch.full((1, 1, 1, 2, 2), 0.5)
    instances = torch.tensor([[[[7, 7], [0, 0]]]])
    loss = segmentation_loss(maps, instances, min_pixels=1, bce_weight=2.0, dice_weight=3.0)
    assert loss.bce.item() == pytest.approx(log(2))
    assert loss.dice.item() == pytest.approx(0.4)
    assert loss.total.item() == pytest.approx(2 * log(2) + 3 * 0.4)
    assert loss.matched == 1


def test_ignored_pixels_and_unlabelled_ones_by_hand():
    # Pixels: instance 0.8, ignored 0.9, unlabelled 0.4 and 0.2.
    maps = torch.tensor([[[[[0.8, 0.9], [0.4, 0.2]]]]])
    instances = torch.tensor([[[[3, -1], [0, 0]]]])
    strict = segmentation_loss(maps, instances, min_pixels=1)
    # Three pixels count; the two unlabelled ones should be 0.
    assert strict.bce.item() == pytest.approx(-(log(0.8) + log(0.6) + log(0.8)) / 3, abs=1e-5)
    assert strict.dice.item() == pytest.approx(1 - (1.6 + 1) / (1.4 + 1 + 1), abs=1e-5)
    lenient = segmentation_loss(maps, instances, min_pixels=1, ignore_unlabelled=True)
    assert lenient.bce.item() == pytest.approx(-log(0.8), abs=1e-5)
    assert lenient.dice.item() == pytest.approx(1 - (1.6 + 1) / (0.8 + 1 + 1), abs=1e-5)


def test_perfect_maps_cost_almost_nothing():
    instances = torch.zeros(1, 2, 8, 8, dtype=torch.long)
    instances[:, :, :4], instances[:, :, 4:] = 5, 9
    maps = torch.stack([(instances == 9).float(), (instances == 5).float()], dim=2)
    loss = segmentation_loss(maps, instances)
    assert loss.total.item() < 1e-4
    assert loss.matched == 2


def test_loss_of_a_batch_is_the_mean_of_the_losses_of_its_scenes(rng):
    """Also where they have unlike numbers of instances, or none: the batch may then be cut."""
    maps, instances = some_maps(rng, batch=3), some_instances(rng, batch=3)
    instances[0][instances[0] > 1] = 0
    instances[2] = 0
    whole = segmentation_loss(maps, instances, min_pixels=1)
    parts = [segmentation_loss(maps[k : k + 1], instances[k : k + 1], min_pixels=1) for k in (0, 1)]
    assert [part.matched for part in parts] == [1, 3]
    expected = torch.stack([part.total for part in parts]).sum() / 3
    torch.testing.assert_close(whole.total, expected)


def test_an_object_is_one_group_in_all_views_together():
    # Group 0 fits view 0, group 1 fits view 1: per view each would be perfect, per scene only
    # one of them can be the object's, and half of it is missed.
    instances = torch.full((1, 2, 4, 4), 0)
    instances[:, :, :2] = 1
    maps = torch.zeros(1, 2, 2, 4, 4)
    maps[0, 0, 0, :2] = maps[0, 1, 1, :2] = 1.0
    loss = segmentation_loss(maps, instances, min_pixels=1)
    assert loss.matched == 1
    assert loss.dice.item() == pytest.approx(1 - (2 * 8 + 1) / (8 + 16 + 1), abs=1e-4)


def test_the_order_of_groups_changes_nothing(rng):
    maps, instances = some_maps(rng), some_instances(rng)
    order = torch.randperm(5, generator=rng)
    first = segmentation_loss(maps, instances, min_pixels=1)
    second = segmentation_loss(maps[:, :, order], instances, min_pixels=1)
    torch.testing.assert_close(second.total, first.total)


def test_equals_pytorchs_bce_in_value_and_gradient(rng):
    # One group and one instance leave nothing to match.
    maps = some_maps(rng, batch=1, groups=1).requires_grad_()
    instances = some_instances(rng, batch=1, most=2)
    loss = segmentation_loss(maps, instances, min_pixels=1)
    (gradient,) = torch.autograd.grad(loss.bce, maps)
    other = functional.binary_cross_entropy(maps[:, :, 0], instances.float())
    torch.testing.assert_close(loss.bce, other)
    torch.testing.assert_close(gradient, torch.autograd.grad(other, maps)[0])


def test_groups_without_a_partner_get_no_gradient(rng):
    maps = some_maps(rng, batch=1).requires_grad_()
    instances = some_instances(rng, batch=1, most=3)  # ids 1 and 2
    segmentation_loss(maps, instances, min_pixels=1).total.backward()
    touched = (maps.grad != 0).flatten(3).any(dim=-1).any(dim=1)[0]
    assert touched.sum() == 2


@pytest.mark.parametrize("fill", [0, -1])
def test_no_instance_costs_nothing_and_still_goes_backward(rng, fill):
    maps = some_maps(rng).requires_grad_()
    instances = torch.full((2, 3, 8, 8), fill)
    loss = segmentation_loss(maps, instances)
    assert loss.total.item() == 0
    assert loss.matched == 0
    loss.total.backward()
    assert maps.grad.abs().max() == 0


def test_small_instances_are_dropped_by_their_pixels_over_all_views():
    instances = torch.zeros(1, 2, 8, 8, dtype=torch.long)
    instances[0, :, 0, :6] = 1  # 12 pixels
    instances[0, 0, 1, :6] = 2  # 6 pixels
    maps = torch.full((1, 2, 3, 8, 8), 0.3)
    assert segmentation_loss(maps, instances, min_pixels=12).matched == 1
    assert segmentation_loss(maps, instances, min_pixels=13).matched == 0
    assert segmentation_loss(maps, instances, min_pixels=6).matched == 2


def test_more_instances_than_groups_match_only_the_groups(rng):
    maps, instances = some_maps(rng, groups=2), some_instances(rng, most=6)
    assert segmentation_loss(maps, instances, min_pixels=1).matched == 4


def test_maps_of_exactly_zero_and_one_stay_finite():
    instances = torch.zeros(1, 1, 8, 8, dtype=torch.long)
    instances[..., :4] = 1
    maps = (instances == 0).float()[:, :, None].requires_grad_()  # exactly wrong
    loss = segmentation_loss(maps, instances)
    loss.total.backward()
    assert loss.total.isfinite()
    assert maps.grad.isfinite().all()


def two_groups(first: tuple[float, float], second: tuple[float, float]) -> torch.Tensor:
    """Maps of two groups, alike over the left and over the right half of a view."""
    maps = torch.empty(1, 1, 2, 8, 8)
    for group, (left, right) in enumerate((first, second)):
        maps[0, 0, group, :, :4], maps[0, 0, group, :, 4:] = left, right
    return maps


def left_half() -> torch.Tensor:
    instances = torch.zeros(1, 1, 8, 8, dtype=torch.long)
    instances[..., :4] = 1
    return instances


def test_a_group_that_is_everywhere_is_no_better_match_for_being_sure_by_hand():
    # BCE of the first: (-log .9 - log .1) / 2 = 1.204; of the second: -log .8 = 0.223.
    # By the instance's own pixels alone, -log(m / (1 - m)), the first would be the cheaper.
    maps = two_groups((0.9, 0.9), (0.8, 0.2))
    loss = segmentation_loss(maps, left_half(), dice_weight=0.0)
    assert loss.total.item() == pytest.approx(-log(0.8), abs=1e-5)


def test_dice_decides_where_bce_has_no_weight_by_hand():
    # Dice of the first: 1 - (2 * 32 * .1 + 1) / (64 * .1 + 32 + 1) = 0.812; of the second, with
    # .9 and .1: 1 - (2 * 32 * .9 + 1) / (32 + 32 + 1) = 0.098.
    maps = two_groups((0.1, 0.1), (0.9, 0.1))
    loss = segmentation_loss(maps, left_half(), bce_weight=0.0)
    assert loss.total.item() == pytest.approx(1 - 58.6 / 65, abs=1e-5)


@pytest.mark.parametrize("weights", [(1.0, 1.0), (0.0, 1.0), (1.0, 0.0), (3.0, 0.5)])
@pytest.mark.parametrize("ignore_unlabelled", [False, True])
def test_the_pairs_are_the_cheapest_of_all_by_trying(rng, weights, ignore_unlabelled):
    maps, instances = some_maps(rng, batch=1), some_instances(rng, batch=1)
    settings = {
        "bce_weight": weights[0],
        "dice_weight": weights[1],
        "min_pixels": 1,
        "ignore_unlabelled": ignore_unlabelled,
    }
    ids = torch.tensor([1, 2, 3])
    costs = [
        segmentation_loss(maps, instances, pairs=[Pairs(torch.tensor(groups), ids)], **settings)
        for groups in permutations(range(5), 3)
    ]
    cheapest = min(float(each.total) for each in costs)
    found = segmentation_loss(maps, instances, **settings)
    assert found.total.item() == pytest.approx(cheapest, rel=1e-5)
