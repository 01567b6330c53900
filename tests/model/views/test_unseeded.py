import torch

from instok3d.model.views.unseeded import without_patches
from made_scene import made_tokens


def test_anchors_go_with_their_gaussians_and_the_rest_stays():
    groups = made_tokens()
    patches = groups.anchors.patches[0]
    unseeded = torch.zeros(int(patches.max()) + 1, dtype=torch.bool)
    unseeded[patches[0]] = True
    left = without_patches(groups, unseeded)
    kept = patches != patches[0]
    assert torch.equal(left.anchors.positions, groups.anchors.positions[:, kept])
    assert torch.equal(left.assignment, groups.assignment[:, kept])
    index = groups.gaussians.anchor_index[0]
    assert torch.equal(left.gaussians.means, groups.gaussians.means[:, kept[index]])
    at_old = left.anchors.positions[0, left.gaussians.anchor_index[0]]
    assert torch.equal(at_old, groups.anchors.positions[0, index[kept[index]]])


def test_nothing_and_everything_can_be_left_out():
    groups = made_tokens()
    count = int(groups.anchors.patches.max()) + 1
    same = without_patches(groups, torch.zeros(count, dtype=torch.bool))
    assert torch.equal(same.gaussians.means, groups.gaussians.means)
    assert torch.equal(same.gaussians.anchor_index, groups.gaussians.anchor_index)
    empty = without_patches(groups, torch.ones(count, dtype=torch.bool))
    assert empty.gaussians.means.shape == (1, 0, 3)
    assert empty.assignment.shape[1] == 0
