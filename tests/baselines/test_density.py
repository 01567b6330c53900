import torch

from instok3d.baselines.density import DensityControl
from instok3d.baselines.settings import DensitySettings
from instok3d.refinement.parameters import GaussianParameters
from instok3d.types import Cameras

SETTINGS = DensitySettings(first=0.1, last=0.5, every=10, gradient_min=0.5, reset_at=0.3, most=100)
CAMERA = Cameras(torch.eye(4)[None], torch.tensor([[[8.0, 0, 8], [0, 8, 8], [0, 0, 1]]]))


def parameters(opacities: list[float], sizes: list[float]) -> GaussianParameters:
    count = len(sizes)
    means = torch.tensor([[0.0, 0, 2]]).repeat(count, 1) + torch.arange(count)[:, None]
    quats = torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1)
    logits = torch.tensor(opacities).logit()
    scales = torch.tensor(sizes).log()[:, None].repeat(1, 3)
    own = GaussianParameters(means, scales, quats, logits, torch.zeros(count, 1, 3),
                             torch.zeros(count, 0, 3))  # fmt: skip
    return own.map(torch.Tensor.requires_grad_)


def control(settings: DensitySettings = SETTINGS) -> DensityControl:
    return DensityControl(settings, 100, extent=1.0, seed=0)


def watched(density: DensityControl, own: GaussianParameters, gradients: list[float]) -> None:
    """Each centre pulled along x."""
    own.means.grad = torch.tensor(gradients)[:, None] * torch.tensor([1.0, 0, 0])
    density.watch(own, CAMERA, width=16)


def test_pulled_gaussians_are_cloned_if_small_and_split_if_large():
    own, density = parameters([0.5] * 3, [0.001, 0.1, 0.1]), control()
    # In the picture, in halves of its width of 16: gradient x z / focal x 8 = gradient x z here.
    watched(density, own, [0.26, 0.2, 0.1])  # at z = 2, 3, 4: 0.52, 0.6 and 0.4
    change = density.changed(own, 9)
    assert change.source.tolist() == [0, 0, 1, 1, 2]
    assert change.fresh.tolist() == [False, True, True, True, False]
    new = change.parameters
    assert torch.equal(new.means[1], own.means[0])
    assert torch.equal(new.means[4], own.means[2])
    assert not torch.equal(new.means[2], new.means[3])
    torch.testing.assert_close(new.log_scales[2].exp(), torch.full((3,), 0.1 / 1.6))
    torch.testing.assert_close(new.log_scales[0], own.log_scales[0].detach())


def test_the_pull_is_the_mean_over_the_views_that_see_the_gaussian():
    own, density = parameters([0.5], [0.001]), control()
    for gradient in (0.4, 0.0, 0.2):  # 0.8 and 0.4 where it is seen: 0.6
        watched(density, own, [gradient])
    assert len(density.changed(own, 9).source) == 2
    # What was watched is forgotten: the same again would need new gradients.
    watched(density, own, [0.2])
    assert len(density.changed(own, 19).source) == 1


def test_faint_gaussians_and_after_the_reset_huge_ones_are_removed():
    own, density = parameters([0.5, 0.004, 0.5], [0.1, 0.1, 0.6]), control()
    watched(density, own, [0.0, 9.0, 0.0])
    assert density.changed(own, 9).source.tolist() == [0, 2]
    watched(density, own, [0.0, 9.0, 0.0])
    assert density.changed(own, 39).source.tolist() == [0]


def test_none_is_added_beyond_the_most():
    own = parameters([0.5] * 4, [0.001] * 4)
    density = control(DensitySettings(gradient_min=0.5, most=6))
    watched(density, own, [1.0, 4.0, 3.0, 2.0])  # at depths 2 to 5: the largest are 1, 2, 3
    assert density.changed(own, 9).source.tolist() == [0, 1, 1, 2, 2, 3]


def test_rounds_and_the_reset_come_when_the_settings_say():
    density = control()
    assert [step for step in range(100) if density.is_due(step)] == [9, 19, 29, 39, 49]
    assert [step for step in range(100) if density.resets(step)] == [29]
    never = control(DensitySettings(reset_at=0.0))
    assert not any(never.resets(step) for step in range(100))
    own = parameters([0.5, 0.002], [0.1, 0.1])
    density.reset(own)
    torch.testing.assert_close(own.opacity_logits.sigmoid(), torch.tensor([0.01, 0.002]))


def test_no_gaussian_stays_none():
    own, density = parameters([], []), control()
    watched(density, own, [])
    assert len(density.changed(own, 9).source) == 0
