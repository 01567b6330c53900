import torch

from instok3d.refinement.parameters import GaussianParameters
from instok3d.refinement.splitting import APART, SHRINK, split_largest
from instok3d.types import Gaussians


def three() -> GaussianParameters:
    scales = torch.tensor([[0.1, 0.1, 0.1], [0.1, 0.4, 0.2], [0.5, 0.1, 0.1]])
    return GaussianParameters.of(
        Gaussians(
            torch.zeros(3, 3), torch.tensor([[1.0, 0, 0, 0]] * 3), scales, torch.full((3,), 0.5),
            torch.rand(3, 4, 3), torch.arange(3),
        )
    )  # fmt: skip


def test_the_most_pulled_one_is_split_along_its_longest_axis():
    parameters = three()
    split = split_largest(parameters, torch.tensor([1.0, 1.0, 0.1]), share=0.4)
    assert split.source.tolist() == [0, 1, 1, 2]
    step = torch.tensor([0.0, APART * 0.4, 0.0])
    torch.testing.assert_close(split.parameters.means[1], step)
    torch.testing.assert_close(split.parameters.means[2], -step)
    torch.testing.assert_close(split.moved, split.parameters.means)
    expected = torch.tensor([0.1, 0.4 / SHRINK, 0.2])
    torch.testing.assert_close(split.parameters.log_scales[1].exp(), expected)
    torch.testing.assert_close(split.parameters.log_scales[2].exp(), expected)
    torch.testing.assert_close(split.parameters.log_scales[3], parameters.log_scales[2])
    assert torch.equal(split.parameters.sh_constant[2], parameters.sh_constant[1])


def test_without_pressure_or_share_nothing_is_split():
    for pressure, share in ((torch.zeros(3), 1.0), (torch.ones(3), 0.0)):
        split = split_largest(three(), pressure, share)
        assert split.source.tolist() == [0, 1, 2]
        assert torch.equal(split.parameters.log_scales, three().log_scales)
    none = split_largest(three().map(lambda value: value[:0]), torch.zeros(0), 1.0)
    assert len(none.source) == 0
