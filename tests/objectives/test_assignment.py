from itertools import permutations
from math import log

import pytest
import torch

from instok3d.objectives.assignment import assignment_loss
from instok3d.objectives.matching import Pairs
from instok3d.objectives.segmentation import segmentation_loss


def some_assignment(rng, *, batch=2, anchors=12, groups=5) -> torch.Tensor:
    return (2 * torch.randn(batch, anchors, groups + 1, generator=rng)).softmax(dim=-1)


def some_patches(rng, *, batch=2, anchors=12, pixels=9, most=4) -> torch.Tensor:
    return torch.randint(-1, most, (batch, anchors, pixels), generator=rng)


def test_cross_entropy_and_dice_by_hand():
    # Two anchors of four pixels. Anchor 0 sees instance 7 alone; anchor 1 half of it, a pixel of
    # nothing and an ignored one. Group 1 answers for 7: it has .6 and .5 of the anchors.
    pi = torch.tensor([[[0.3, 0.6, 0.1], [0.25, 0.5, 0.25]]])
    instances = torch.tensor([[[7, 7, 7, 7], [7, 7, 0, -1]]])
    loss = assignment_loss(pi, instances, min_pixels=1, cross_entropy_weight=2.0, dice_weight=3.0)
    cross_entropy = -(4 * log(0.6) + 2 * log(0.5) + log(0.25)) / 7
    # Pixels: both 4 * .6 + 2 * .5 = 3.4; the group's 4 * .6 + 3 * .5 = 3.9; the instance's 6.
    dice = 1 - (2 * 3.4 + 1) / (3.9 + 6 + 1)
    assert loss.pairs[0].groups.tolist() == [1]
    assert loss.pairs[0].ids.tolist() == [7]
    assert loss.cross_entropy.item() == pytest.approx(cross_entropy, abs=1e-6)
    assert loss.dice.item() == pytest.approx(dice, abs=1e-6)
    assert loss.total.item() == pytest.approx(2 * cross_entropy + 3 * dice, abs=1e-6)


def test_unlabelled_pixels_ask_for_the_void_unless_they_are_ignored():
    # One pixel of an instance, one of none: with the void at .2, or without it.
    pi = torch.tensor([[[0.8, 0.2]]])
    instances = torch.tensor([[[4, 0]]])
    strict = assignment_loss(pi, instances, min_pixels=1)
    lenient = assignment_loss(pi, instances, min_pixels=1, ignore_unlabelled=True)
    assert strict.cross_entropy.item() == pytest.approx(-(log(0.8) + log(0.2)) / 2, abs=1e-6)
    assert lenient.cross_entropy.item() == pytest.approx(-log(0.8), abs=1e-6)
    assert lenient.dice < strict.dice


def test_a_perfect_assignment_costs_nothing():
    instances = torch.tensor([3, 3, 9, 0])[None, :, None].expand(1, 4, 25)
    pi = torch.eye(3)[[1, 1, 0, 2]][None]
    loss = assignment_loss(pi, instances)
    assert loss.total.item() == pytest.approx(0, abs=1e-6)
    assert dict(zip(*(t.tolist() for t in vars(loss.pairs[0]).values()), strict=True)) == {
        0: 9,
        1: 3,
    }


def test_a_group_without_partner_is_held_off_what_belongs_to_another():
    """The rendered loss leaves it alone; here a step downhill takes the anchor away from it."""
    logits = torch.tensor([[[2.0, 0.0, 0.0], [0.0, 1.0, 0.0]]], requires_grad=True)
    instances = torch.full((1, 2, 30), 5)
    loss = assignment_loss(logits.softmax(dim=-1), instances)
    assert loss.pairs[0].groups.tolist() == [0]
    loss.total.backward()
    assert logits.grad is not None
    assert logits.grad[0, 1, 1] > 0 > logits.grad[0, 1, 0]


def test_the_pairs_are_the_cheapest_of_all_by_trying(rng):
    pi, instances = some_assignment(rng, batch=1), some_patches(rng, batch=1)
    loss = assignment_loss(pi, instances, min_pixels=1)
    ids = loss.pairs[0].ids
    assert len(ids) == 3

    def cost(groups) -> float:
        total = torch.zeros(())
        kept = instances[0] >= 0
        for group, instance in zip(groups, ids, strict=True):
            mask = (instances[0] == instance).float()
            share = pi[0, :, group, None]
            both, mine = (share * mask).sum(), (share * kept).sum()
            total += 0.2 * -(share.log() * mask).sum() / kept.sum()
            total += 1 - (2 * both + 1) / (mine + mask.sum() + 1)
        return float(total)

    costs = {groups: cost(groups) for groups in permutations(range(5), 3)}
    assert min(costs, key=lambda groups: costs[groups]) == tuple(loss.pairs[0].groups.tolist())


def test_the_order_of_anchors_and_groups_changes_nothing(rng):
    pi, instances = some_assignment(rng), some_patches(rng)
    first = assignment_loss(pi, instances, min_pixels=1)
    anchors, groups = torch.randperm(12, generator=rng), torch.randperm(5, generator=rng)
    moved = pi[:, anchors][:, :, torch.cat([groups, torch.tensor([5])])]
    second = assignment_loss(moved, instances[:, anchors], min_pixels=1)
    torch.testing.assert_close(first.total, second.total)


def test_loss_of_a_batch_is_the_mean_of_its_scenes_and_nothing_labelled_costs_nothing(rng):
    pi, instances = some_assignment(rng).requires_grad_(), some_patches(rng)
    instances[1] = -1
    whole = assignment_loss(pi, instances, min_pixels=1)
    part = assignment_loss(pi[:1], instances[:1], min_pixels=1)
    torch.testing.assert_close(whole.total, part.total / 2)
    assert len(whole.pairs[1].ids) == 0
    whole.total.backward()
    assert pi.grad is not None
    assert pi.grad.isfinite().all()
    assert pi.grad[1].abs().max() == 0


def test_more_instances_than_groups_leaves_the_dearest_ones_out(rng):
    pi = some_assignment(rng, batch=1, groups=2)
    loss = assignment_loss(pi, some_patches(rng, batch=1, most=6), min_pixels=1)
    assert sorted(loss.pairs[0].groups.tolist()) == [0, 1]


def test_the_match_made_on_anchors_holds_for_rendered_maps():
    # By its maps group 0 would have instance 5; it was given to group 1, and 8 is not in view.
    maps = torch.zeros(1, 1, 2, 4, 4)
    maps[0, 0, 0] = 1.0
    instances = torch.full((1, 1, 4, 4), 5)
    free = segmentation_loss(maps, instances, min_pixels=1)
    pairs = Pairs(torch.tensor([1, 0]), torch.tensor([5, 8]))
    bound = segmentation_loss(maps, instances, min_pixels=1, pairs=[pairs])
    assert free.dice.item() == pytest.approx(0, abs=1e-4)
    assert bound.matched == 1
    assert bound.dice.item() == pytest.approx(1 - 1 / 17, abs=1e-4)
    nothing = Pairs(torch.zeros(0, dtype=torch.long), torch.zeros(0, dtype=torch.long))
    assert segmentation_loss(maps, instances, min_pixels=1, pairs=[nothing]).total.item() == 0
