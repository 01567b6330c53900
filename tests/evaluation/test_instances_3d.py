from dataclasses import replace

import pytest
import torch

from flat_rooms import FlatRooms, in_another_world, oracle
from instok3d.data.batches import make_sample
from instok3d.data.view_sampling import FrameChoice
from instok3d.evaluation.instance_ap import average_precision
from instok3d.evaluation.instances_3d import group_densities, match_points, true_points
from instok3d.evaluation.methods import FittedScene, show
from instok3d.evaluation.prediction import predict_by
from instok3d.evaluation.tokenizer_method import TokenizerMethod
from instok3d.types import Gaussians

SAMPLE = make_sample(FlatRooms([0], ["easy"]), 0, FrameChoice((4, 12), (6,)))


def scene(unit: float = 1.0) -> FittedScene:
    return TokenizerMethod(oracle(SAMPLE, unit=unit)).fit(show(SAMPLE, frozenset()))


def test_points_lie_on_the_surfaces_of_their_instances():
    points = true_points(SAMPLE)
    assert points is not None
    assert len(points.positions) == 2 * 32 * 32
    # The wall at 3 and the boards at 2.5 and 2.2, in the frame of the first camera.
    for name, depth in ((1, 3.0), (2, 2.5), (3, 2.2)):
        z = points.positions[points.instances == name, 2]
        torch.testing.assert_close(z, torch.full_like(z, depth), atol=2e-3, rtol=0)


@pytest.mark.parametrize(("unit", "where"), [(1.0, "true"), (1.0, "aligned"), (1.7, "aligned")])
def test_the_true_scene_has_the_true_instances_in_any_unit(unit, where):
    matches = match_points(scene(unit), SAMPLE, where)
    assert matches is not None
    figures = average_precision([matches])
    assert (figures.num_instances, figures.num_masks) == (3, 3)
    assert figures.ap_scannet == 1.0


def test_the_true_world_does_not_matter_for_photos():
    moved = in_another_world(SAMPLE)
    matches = match_points(scene(1.3), moved, "aligned")
    assert matches is not None
    assert average_precision([matches]).ap_scannet == 1.0


def test_a_scene_of_another_length_fails_where_it_is_not_aligned():
    matches = match_points(scene(1.7), SAMPLE, "true")
    assert matches is not None
    assert average_precision([matches]).ap50 < 0.5


def test_half_of_a_thing_is_one_half_right():
    whole = scene()
    assert whole.assignment is not None
    means = whole.gaussians.means
    left = (whole.assignment[:, 1] > 0) & (means[:, 0] < -0.4)
    halved = whole.assignment.clone()
    halved[left] = torch.eye(6)[4]
    matches = match_points(replace(whole, assignment=halved), SAMPLE, "true")
    assert matches is not None
    assert len(matches.scores) == 4
    assert matches.true_positive[1].sum() >= 2  # the boards, at IoU .5


def test_the_density_of_a_group_is_that_of_its_gaussians():
    gaussians = Gaussians(
        means=torch.tensor([[0.0, 0, 0], [1, 0, 0]]),
        quats=torch.tensor([[0.5**0.5, 0, 0, 0.5**0.5], [1, 0, 0, 0]]),  # the first turned by 90
        scales=torch.tensor([[1.0, 2, 1], [1, 1, 1]]),
        opacities=torch.tensor([0.5, 1.0]),
        sh=torch.zeros(2, 1, 3),
        anchor_index=torch.tensor([1, 0]),
    )
    assignment = torch.tensor([[0.0, 1.0], [0.8, 0.2]])
    found = group_densities(gaussians, assignment, torch.tensor([[2.0, 0, 0]]))
    # The first's axis of 2 lies along x: one deviation away. So is the second.
    near = torch.tensor(-0.5).exp()
    expected = torch.stack([0.5 * near * 0.8, 0.5 * near * 0.2 + near])
    torch.testing.assert_close(found[0], expected)


def test_what_is_not_known_is_none():
    nothing = replace(SAMPLE, context_instances=torch.zeros_like(SAMPLE.context_instances))
    assert match_points(scene(), nothing, "true") is None
    assert match_points(replace(scene(), assignment=None), SAMPLE, "true") is None
    empty = scene()
    empty = replace(empty, gaussians=empty.gaussians.rows(slice(0)))
    matches = match_points(empty, SAMPLE, "true")
    assert matches is not None
    assert (matches.num_instances, len(matches.scores)) == (3, 0)


def test_it_is_measured_if_that_is_asked_for():
    method = TokenizerMethod(oracle(SAMPLE, unit=1.7))
    asked = predict_by(method, SAMPLE, target_cameras="aligned", with_instances_3d=True)
    assert asked.instances_3d is not None
    assert asked.instances_3d.true_positive[-1].all()
    assert predict_by(method, SAMPLE, target_cameras="aligned").instances_3d is None
