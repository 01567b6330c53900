from dataclasses import replace

import pytest
import torch

from flat_rooms import oracle
from instok3d.evaluation.methods import Cost, FittedScene, Method, Seen, Shown, show
from instok3d.evaluation.prediction import predict_by
from instok3d.evaluation.protocols import ProtocolScene
from instok3d.evaluation.report import as_table
from instok3d.evaluation.run import EvaluationSettings, evaluate
from instok3d.evaluation.tokenizer_method import TokenizerMethod


class Flat:
    """A method that answers with the true scene, and remembers what it was shown."""

    def __init__(self, sample, needs: frozenset, knows_instances: bool = True):
        self.sample, self.needs, self.knows_instances = sample, needs, knows_instances
        self.shown: list[Shown] = []

    def fit(self, shown: Shown) -> FittedScene:
        self.shown.append(shown)
        groups = oracle(self.sample)(shown.views)
        return FittedScene(
            groups.gaussians.scene(0), groups.assignment[0] if self.knows_instances else None,
            groups.geometry.cameras.scene(0), Cost(2048, 3, 7, 0.5),
        )  # fmt: skip


def test_a_method_is_shown_what_it_needs_and_no_more(flat_sample):
    masks = flat_sample.context_instances[0]
    bare = show(flat_sample, frozenset(), masks)
    assert bare.views.intrinsics is bare.views.cam_from_world is bare.views.depths is None
    assert bare.masks is None
    told = show(flat_sample, frozenset({"intrinsics", "depth"}), masks)
    assert told.views.cam_from_world is None
    assert torch.equal(told.views.intrinsics, flat_sample.context.intrinsics)
    assert torch.equal(told.views.depths, flat_sample.context.depths)
    posed = show(flat_sample, frozenset({"cameras", "masks"}), masks)
    assert torch.equal(posed.cameras.cam_from_world, flat_sample.context.cam_from_world[0])
    assert posed.views.depths is None
    assert torch.equal(posed.masks, masks)


def test_what_is_missing_is_said(flat_sample):
    with pytest.raises(ValueError, match="needs masks of the context views, got none"):
        show(flat_sample, frozenset({"masks"}))
    with pytest.raises(ValueError, match="cameras of the context views are not shown"):
        _ = show(flat_sample, frozenset()).cameras


def test_the_tokenizer_is_a_method_and_a_plain_model_is_none(flat_sample):
    model = oracle(flat_sample)
    assert not isinstance(model, Method)
    method = TokenizerMethod(model, "given")
    assert isinstance(method, Method)
    assert method.needs == {"cameras", "depth"}
    scene = method.fit(show(flat_sample, method.needs))
    assert (scene.cost.gaussians, scene.cost.semantic_units) == (2048, 3)
    assert scene.cost.label_scalars == 2048 * 6
    assert scene.cost.fit_s > 0
    assert scene.geometry is not None


def test_a_scene_without_instances_has_pictures_alone(flat_sample):
    method = Flat(flat_sample, frozenset({"cameras", "depth"}), knows_instances=False)
    prediction = predict_by(method, flat_sample, target_cameras="true", with_objects=True)
    assert prediction.masks is prediction.num_groups_used is prediction.objects is None
    assert prediction.images.shape == flat_sample.target.images[0].shape
    with_ids = predict_by(method, flat_sample, target_cameras="true", with_ids=True)
    assert with_ids.rendered_ids is None


def test_features_are_composited_and_the_best_group_wins(flat_sample):
    scene = Flat(flat_sample, frozenset()).fit(show(flat_sample, frozenset()))
    cameras = scene.cameras.view(0)
    seen = scene.at(cameras, 32, 32)
    assert isinstance(seen, Seen)
    assert seen.rendering.features is None
    assert seen.masks is not None
    true = flat_sample.context_instances[0, 0].numpy()
    assert (seen.masks[0].ids == true).mean() > 0.9  # columns of the oracle are ids
    void = torch.zeros_like(scene.assignment)
    void[:, -1] = 1
    nothing = replace(scene, assignment=void)
    assert nothing.num_groups_used() == 0
    assert (nothing.at(cameras, 32, 32).masks[0].ids == -1).all()


def test_any_method_is_measured_by_the_protocols(flat_sample):
    scenes = [ProtocolScene("7", "easy", (flat_sample,))]
    given = EvaluationSettings(geometry="given", baselines=True)
    method = Flat(flat_sample, frozenset({"cameras", "masks"}))
    masks = flat_sample.context_instances[0] + 5
    report = evaluate(
        method, scenes, given, protocol="rooms-2view", model_name="flat",
        masks_of=lambda sample: masks,
    )  # fmt: skip
    assert torch.equal(method.shown[0].masks, masks)
    assert report.figures.ap50 == 1.0
    assert report.true_targets == 1
    assert report.figures.rotation_deg is None
    assert "context photo warped by depth" not in report.baselines
    with pytest.raises(ValueError, match=r"needs given cameras.*'predicted'"):
        evaluate(method, scenes, protocol="rooms-2view", model_name="flat")
    with pytest.raises(ValueError, match="needs masks"):
        evaluate(method, scenes, given, protocol="rooms-2view", model_name="flat")


def test_a_report_says_what_a_scene_costs_and_whose_instances_are_missing(flat_sample):
    scenes = [ProtocolScene("7", "easy", (flat_sample,))]
    method = Flat(flat_sample, frozenset({"cameras"}), knows_instances=False)
    given = EvaluationSettings(geometry="given")
    table = as_table(evaluate(method, scenes, given, protocol="rooms-2view", model_name="flat"))
    assert "AP was not measured: the scenes or the method know no instances." in table
    assert "2048 Gaussians, 3 units with semantics, 7 numbers for labels and 0 for" in table
    assert "it takes 0.50 s" in table
