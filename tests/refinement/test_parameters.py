import pytest
import torch

from instok3d.refinement.parameters import OPACITY_EDGE, GaussianParameters
from instok3d.refinement.settings import LearningRates, RefinementSettings
from instok3d.types import Gaussians
from made_scene import made_tokens


@pytest.fixture
def gaussians() -> Gaussians:
    return made_tokens().gaussians.scene(0)


def test_gaussians_come_back(gaussians: Gaussians):
    back = GaussianParameters.of(gaussians).gaussians(gaussians.anchor_index)
    for name, value in vars(gaussians).items():
        torch.testing.assert_close(getattr(back, name), value, msg=name)


def test_opaque_and_clear_gaussians_stay_finite():
    opacities = torch.tensor([0.0, 1.0])
    rows = Gaussians(
        torch.zeros(2, 3), torch.tensor([[1.0, 0, 0, 0]] * 2), torch.ones(2, 3), opacities,
        torch.zeros(2, 1, 3), torch.zeros(2, dtype=torch.long),
    )  # fmt: skip
    parameters = GaussianParameters.of(rows)
    assert parameters.opacity_logits.isfinite().all()
    back = parameters.gaussians(rows.anchor_index)
    torch.testing.assert_close(back.opacities, opacities, atol=2 * OPACITY_EDGE, rtol=0)
    assert back.sh.shape == (2, 1, 3)


def test_the_input_is_not_changed_by_a_step(gaussians: Gaussians):
    before = gaussians.map(torch.clone)
    parameters = GaussianParameters.of(gaussians)
    optimizer = parameters.optimizer(LearningRates(), length=2.0)
    torch.stack([value.sum() for value in vars(parameters).values()]).sum().backward()
    optimizer.step()
    for name, value in vars(before).items():
        assert torch.equal(getattr(gaussians, name), value), name


def test_a_first_step_of_adam_is_the_rate_of_each_field(gaussians: Gaussians):
    parameters = GaussianParameters.of(gaussians)
    start = parameters.map(torch.clone)
    rates = LearningRates(means=1e-3, log_scales=2e-3, opacity_logits=3e-3)
    optimizer = parameters.optimizer(rates, length=2.0)
    torch.stack([value.sum() for value in vars(parameters).values()]).sum().backward()
    optimizer.step()
    for name, step in (("means", 2e-3), ("log_scales", 2e-3), ("opacity_logits", 3e-3)):
        moved = getattr(start, name) - getattr(parameters, name).detach()
        torch.testing.assert_close(moved, torch.full_like(moved, step), atol=1e-6, rtol=0)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"steps": -1}, "steps"),
        ({"steps": 10**9}, "steps"),
        ({"views_per_step": 0}, "views_per_step"),
        ({"coarse_share": 1.5}, "coarse_share"),
        ({"split_share": float("nan")}, "split_share"),
        ({"mean_pull": float("inf")}, "mean_pull"),
    ],
)
def test_settings_out_of_range_are_named(change: dict, named: str):
    with pytest.raises(ValueError, match=named):
        RefinementSettings(**change)
