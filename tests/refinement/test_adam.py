import subprocess
import sys
from pathlib import Path

import torch

from instok3d.refinement.adam import Adam


def test_steps_are_those_of_torch_bit_for_bit():
    generator = torch.Generator().manual_seed(0)
    start = [torch.randn(7, 3, generator=generator), torch.randn(5, generator=generator)]
    rates = [0.1, 0.003]
    ours, theirs = ([value.clone().requires_grad_() for value in start] for _ in range(2))
    optimizer = Adam(list(zip(ours, rates, strict=True)), eps=1e-15)
    twin = torch.optim.Adam(
        [{"params": [value], "lr": rate} for value, rate in zip(theirs, rates, strict=True)],
        eps=1e-15, fused=True,
    )  # fmt: skip
    for _ in range(5):
        for value, same in zip(ours, theirs, strict=True):
            value.square().sum().backward()
            same.square().sum().backward()
        optimizer.step()
        twin.step()
        twin.zero_grad()
    for value, same, first in zip(ours, theirs, start, strict=True):
        assert torch.equal(value, same)
        assert not torch.equal(value, first)
        assert value.grad is None


def test_values_without_a_gradient_stay():
    moved, still = torch.ones(2, requires_grad=True), torch.ones(0, requires_grad=True)
    optimizer = Adam([(moved, 0.5), (still, 0.5)], eps=1e-8)
    moved.sum().backward()
    optimizer.step()
    torch.testing.assert_close(moved.detach(), torch.full((2,), 0.5))
    assert still.shape == (0,)


def test_rows_that_stay_keep_their_moments_and_fresh_ones_begin_anew():
    generator = torch.Generator().manual_seed(0)
    start, gradient = torch.randn(2, 3, 2, generator=generator).unbind()

    def pulled(value: torch.Tensor, optimizer: Adam, slope: torch.Tensor) -> None:
        value.grad = slope.clone()
        optimizer.step()

    whole = start.clone().requires_grad_()
    optimizer = Adam([(whole, 0.1)], eps=1e-15)
    pulled(whole, optimizer, gradient)
    source, fresh = torch.tensor([2, 0, 0]), torch.tensor([False, False, True])
    rows = whole.detach()[source].clone().requires_grad_()
    optimizer.replace(0, rows, source, fresh)
    twin = start.clone().requires_grad_()
    reference = Adam([(twin, 0.1)], eps=1e-15)
    for _ in range(2):
        pulled(twin, reference, gradient)
    pulled(rows, optimizer, gradient[source])
    torch.testing.assert_close(rows[:2], twin[source[:2]])
    # One gradient g of a fresh row in the second step: rate * (.1 / .19) g / sqrt(.001 / .001999) g
    step = 0.1 * (0.1 / 0.19) / (0.001 / 0.001999) ** 0.5
    moved = start[0] - 0.1 * gradient[0].sign() - step * gradient[0].sign()
    torch.testing.assert_close(rows[2].detach(), moved)


def test_a_rate_can_change():
    value = torch.zeros(1, requires_grad=True)
    optimizer = Adam([(value, 0.5)], eps=1e-15)
    optimizer.set_rate(0, 0.25)
    value.sum().backward()
    optimizer.step()
    torch.testing.assert_close(value.detach(), torch.tensor([-0.25]))


def test_refining_imports_no_compiler():
    # torch._dynamo and all that it imports: 800 modules, a second.
    code = (
        "import sys, torch\n"
        "from instok3d.refinement.optimization import refine_gaussians\n"
        "from instok3d.refinement.settings import RefinementSettings\n"
        "from made_scene import HEIGHT, WIDTH, made_tokens\n"
        "tokens = made_tokens(num_views=2)\n"
        "photos = torch.zeros(2, 3, HEIGHT, WIDTH)\n"
        "result = refine_gaussians(tokens.gaussians.scene(0), tokens.geometry.cameras.scene(0),\n"
        "    photos, RefinementSettings(steps=2), near=0.05, far=100.0)\n"
        "assert result.steps == 2\n"
        "assert 'torch._dynamo' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[1])
