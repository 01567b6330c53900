import pytest
import torch

from fake_rooms import FakeRooms
from instok3d.backbones.nano.backbone import NanoBackbone, NanoConfig
from instok3d.data.batches import BatchConfig, SceneBatches
from instok3d.data.sample import Sample
from instok3d.training.stages.geometry import GeometryStage, GeometryStageConfig

PLAIN = NanoConfig(width=64, layers=1, match_channels=16, refinement_layers=0)
REFINED = NanoConfig(width=64, layers=1, match_channels=16, refinement_layers=1)


@pytest.fixture(scope="module")
def sample() -> Sample:
    config = BatchConfig(2, num_targets=1)
    return SceneBatches(FakeRooms(2, size=32), [0, 1], config, seed=0).batch(0)


@pytest.fixture
def refining() -> GeometryStage:
    torch.manual_seed(0)
    return GeometryStage(GeometryStageConfig(REFINED, trained="refinement"))


def test_refinement_learns_on_a_network_that_stays(refining, sample):
    model = refining.build_model()
    trained = [p for p in model.parameters() if p.requires_grad]
    assert {id(p) for p in trained} == {id(p) for p in model.refinement.parameters()}
    optimizer = torch.optim.Adam(trained, lr=3e-3)
    before = {k: v.clone() for k, v in model.state_dict().items()}
    errors = []
    for _ in range(12):
        loss = refining.loss(model, sample, 0)
        optimizer.zero_grad()
        loss.total.backward()
        optimizer.step()
        errors.append(loss.terms["depth"].item())
    assert errors[-1] < 0.9 * errors[0]
    changed = {k for k, v in model.state_dict().items() if not torch.equal(v, before[k])}
    assert changed
    assert all(name.startswith("refinement.") for name in changed)


def test_the_network_learns_without_the_refinement(sample):
    torch.manual_seed(0)
    stage = GeometryStage(GeometryStageConfig(REFINED))
    model = stage.build_model()
    assert model.refinement is not None
    stage.loss(model, sample, 0).total.backward()
    assert all(p.grad is None for p in model.refinement.parameters())
    assert model.to_coarse_depth.weight.grad is not None


def test_first_weights_may_lack_the_refinement_but_nothing_else(refining):
    network = NanoBackbone(PLAIN).state_dict()
    model = refining.build_model()
    refining.load_initial(model, {f"backbone.{k}": v for k, v in network.items()})
    assert all(torch.equal(model.state_dict()[k], v) for k, v in network.items())
    network.pop("to_coarse_depth.weight")
    with pytest.raises(RuntimeError, match=r"to_coarse_depth\.weight"):
        refining.load_initial(model, network)


def test_a_backbone_without_refinement_cannot_train_it():
    with pytest.raises(ValueError, match="refinement_layers is 0"):
        GeometryStage(GeometryStageConfig(PLAIN, trained="refinement"))


def test_figures_are_those_of_the_refined_depth(refining, sample):
    model = refining.build_model().eval()
    with torch.no_grad():
        before = refining.validate(model, [sample])
        torch.nn.init.normal_(model.refinement.correct.weight)
        after = refining.validate(model, [sample])
    assert before["depth_rel"] != after["depth_rel"]
    assert before["loss"] != after["loss"]
