import pytest
import torch

from instok3d.objectives.matching import match_groups


def test_the_cheapest_pairs_are_taken_together():
    # Greedily instance 0 would take group 0 (cost 1) and leave 9: 10 in all. Together: 2 + 2.
    match = match_groups(torch.tensor([[1.0, 2.0], [2.0, 9.0]]))
    assert match.groups.tolist() == [0, 1]
    assert match.instances.tolist() == [1, 0]


@pytest.mark.parametrize(("groups", "instances"), [(5, 2), (2, 5), (3, 0)])
def test_as_many_pairs_as_the_smaller_side(rng, groups, instances):
    match = match_groups(torch.rand(groups, instances, generator=rng))
    pairs = min(groups, instances)
    assert len(set(match.groups.tolist())) == pairs
    assert len(set(match.instances.tolist())) == pairs


def test_a_cost_that_is_not_finite_is_refused():
    with pytest.raises(ValueError, match="must be finite"):
        match_groups(torch.tensor([[torch.nan, 1.0]]))
