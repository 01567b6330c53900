"""Each coefficient of the spherical harmonics shows where it should, in every backend."""

import numpy as np
import pytest
import torch

from harmonics import harmonic
from instok3d.geometry.cameras import rigid
from instok3d.render import native_backend, render
from instok3d.types import Cameras, Gaussians

AMOUNT = 0.4
SIZE = 9


def one_gaussian(sh: torch.Tensor) -> Gaussians:
    """At the origin, 0.9 opaque, wider than the picture."""
    return Gaussians(
        means=torch.zeros(1, 3),
        quats=torch.tensor([[1.0, 0, 0, 0]]),
        scales=torch.full((1, 3), 0.5),
        opacities=torch.tensor([0.9]),
        sh=sh,
        anchor_index=torch.zeros(1, dtype=torch.long),
    )


def cameras_towards_the_origin(directions: torch.Tensor) -> Cameras:
    """Two units before the origin, looking along each direction at it."""
    aside = torch.linalg.cross(torch.tensor([0.3, 0.5, 0.8]).expand_as(directions), directions)
    right = torch.nn.functional.normalize(aside, dim=-1)
    rotation = torch.stack([right, torch.linalg.cross(directions, right), directions], dim=-2)
    shift = torch.tensor([0.0, 0, 2]).expand_as(directions)
    intrinsics = torch.tensor([[40.0, 0, SIZE / 2], [0, 40, SIZE / 2], [0, 0, 1]])
    return Cameras(rigid(rotation, shift), intrinsics.expand(len(directions), 3, 3))


def backends() -> list[tuple[str, str]]:
    sets = native_backend.native_status().instruction_sets
    return [("reference", "auto"), *(("native", name) for name in sets)]


@pytest.mark.parametrize(("backend", "instruction_set"), backends())
def test_colours_and_their_gradients_are_the_basis_functions(
    rng, backend: str, instruction_set: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(native_backend, "instruction_set", instruction_set)
    directions = torch.nn.functional.normalize(torch.randn(6, 3, generator=rng), dim=-1)
    cameras = cameras_towards_the_origin(directions)
    middle = SIZE // 2
    for number in range(16):
        sh = torch.zeros(1, 16, 3)
        sh[0, number] = torch.tensor([AMOUNT, -AMOUNT, AMOUNT / 2])
        sh.requires_grad_()
        pictures = render(one_gaussian(sh), cameras, SIZE, SIZE, backend=backend)
        alphas = pictures.alphas[:, middle, middle].detach().numpy()
        np.testing.assert_allclose(alphas, 0.9, atol=1e-4)
        basis = harmonic(number, directions.double().numpy())
        factors = np.array([AMOUNT, -AMOUNT, AMOUNT / 2])
        expected = 0.9 * (0.5 + factors * basis[:, None])
        shown = pictures.colors[:, :, middle, middle]
        np.testing.assert_allclose(shown.detach().numpy(), expected, atol=2e-4)
        (gradient,) = torch.autograd.grad(shown[:, 0].sum(), sh)
        every = [harmonic(k, directions.double().numpy()).sum() for k in range(16)]
        np.testing.assert_allclose(gradient[0, :, 0].numpy(), 0.9 * np.array(every), atol=2e-3)
        assert not gradient[0, :, 1:].any()
