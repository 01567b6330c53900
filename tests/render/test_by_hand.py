"""Pixels and gradients worked by hand, which every backend must show."""

import math

import pytest
import torch

from instok3d.render import RasterSettings, native_backend, native_status, render
from instok3d.types import Cameras, Gaussians, Rendering

SH_CONSTANT = 0.28209479177387814
BACKENDS = [("reference", "auto"), *(("native", k) for k in native_status().instruction_sets)]


@pytest.fixture(params=BACKENDS, ids=" ".join, autouse=True)
def backend(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    name, instruction_set = request.param
    monkeypatch.setattr(native_backend, "instruction_set", instruction_set)
    return name


def on_the_axis(depths, opacities, *, scale=0.1, colors=None) -> Gaussians:
    """Balls on the optical axis; their colours do not depend on the direction."""
    count = len(depths)
    colors = torch.tensor(colors if colors is not None else [(0.2, 0.4, 0.6)] * count)
    means = torch.zeros(count, 3)
    means[:, 2] = torch.tensor(depths)
    return Gaussians(
        means=means,
        quats=torch.eye(4)[:1].repeat(count, 1),
        scales=torch.full((count, 3), scale),
        opacities=torch.tensor(opacities),
        sh=((colors - 0.5) / SH_CONSTANT)[:, None],
        anchor_index=torch.zeros(count, dtype=torch.long),
    )


def camera(*, focal=(10.0, 10.0), center=(0.5, 0.5)) -> Cameras:
    """At the origin; without arguments its axis meets the centre of pixel (0, 0)."""
    intrinsics = torch.tensor([[focal[0], 0, center[0]], [0, focal[1], center[1]], [0, 0, 1]])
    return Cameras(torch.eye(4)[None], intrinsics[None])


def pixel(gaussians: Gaussians, backend: str, **options) -> Rendering:
    """Pixel (0, 0), on the axis."""
    return render(gaussians, camera(), 1, 1, backend=backend, **options)


def alpha(gaussians: Gaussians, backend: str, **options) -> float:
    return pixel(gaussians, backend, **options).alphas.item()


def test_an_oblique_gaussian_has_the_covariance_of_its_projection(backend: str):
    # Slopes (0.2, -0.1): the mean falls on (10 * 0.2 + 2.5, 20 * -0.1 + 3.5) = (4.5, 1.5). Rows of
    # Jacobian x axes: 10 / 2 * (0.2, 0, -0.2 * 0.3) = (1, 0, -0.3), and
    # 20 / 2 * (0, 0.05, 0.1 * 0.3) = (0, 0.5, 0.3). Covariance: xx = 1.09 + 0.3, xy = -0.09,
    # yy = 0.34 + 0.3, with the determinant 1.39 * 0.64 - 0.09^2 = 0.8815.
    gaussians = on_the_axis([2.0], [0.8])
    gaussians.means[0] = torch.tensor([0.4, -0.2, 2.0])
    gaussians.scales[0] = torch.tensor([0.2, 0.05, 0.3])
    view = camera(focal=(10.0, 20.0), center=(2.5, 3.5))
    alphas = render(gaussians, view, 7, 6, backend=backend).alphas[0]
    for x, y in ((0, 0), (1, 0), (0, 1), (1, 1), (1, -1), (-2, 0), (-1, 1)):
        sigma = (0.5 * (0.64 * x * x + 1.39 * y * y) + 0.09 * x * y) / 0.8815
        assert alphas[1 + y, 4 + x].item() == pytest.approx(0.8 * math.exp(-sigma), rel=1e-4)


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("axis", [0, 1])
def test_the_jacobian_stops_a_bit_beyond_the_border(backend: str, axis: int, side: int):
    # 4 columns x 8 rows, focal 10. The border lies at the slope size / 2 / 10, and the Jacobian
    # is taken 0.15 * size / 10 further: to 0.26 and 0.52. A ball of radius 1 at z = 2 has there
    # the variance 5^2 (1 + limit^2) + 0.3 and across 5^2 + 0.3. Slope 0.8 is 8 pixels off.
    size, limit = (4, 0.26) if axis == 0 else (8, 0.52)
    gaussians = on_the_axis([2.0], [0.9], scale=1.0)
    gaussians.means[0, axis] = side * 1.6
    alphas = render(gaussians, camera(center=(2.0, 4.0)), 8, 4, backend=backend).alphas[0]
    along = 8 - (size / 2 - 0.5)  # from the centre of the last pixel
    sigma = 0.5 * (along**2 / (25 * (1 + limit**2) + 0.3) + 0.5**2 / 25.3)
    last = -1 if side > 0 else 0
    found = alphas[4, last] if axis == 0 else alphas[last, 2]
    assert found.item() == pytest.approx(0.9 * math.exp(-sigma), rel=1e-4)


def test_only_what_lies_between_near_and_far_is_drawn(backend: str):
    ball = on_the_axis([2.0], [0.5])
    for near, far, drawn in (
        (1.99, 2.01, True), (2.0, 3.0, False), (1.0, 2.0, False), (2.01, 3.0, False),
        (1.0, 1.99, False), (0.0, math.inf, True),
    ):  # fmt: skip
        assert (alpha(ball, backend, near=near, far=far) > 0) == drawn
    for depth, scale, drawn in ((0.049, 1e-3, False), (0.051, 1e-3, True), (99.0, 9.0, True),
                                (101.0, 9.0, False)):  # fmt: skip
        assert (alpha(on_the_axis([depth], [0.5], scale=scale), backend) > 0) == drawn


def test_an_alpha_at_the_lower_threshold_is_drawn_and_one_below_is_not(backend: str):
    half = RasterSettings(alpha_min=0.5)
    assert alpha(on_the_axis([2.0], [0.5]), backend, settings=half) == pytest.approx(0.5)
    assert alpha(on_the_axis([2.0], [0.499]), backend, settings=half) == 0
    # By default 1 / 255 = 0.00392.
    assert alpha(on_the_axis([2.0], [0.00395]), backend) == pytest.approx(0.00395, rel=1e-4)
    assert alpha(on_the_axis([2.0], [0.0039]), backend) == 0


def test_an_alpha_is_cut_and_then_has_no_gradient_to_opacity(backend: str):
    for opacity, shown, slope in ((0.7, 0.6, 0.0), (0.5, 0.5, 1.0)):
        gaussians = on_the_axis([2.0], [opacity])
        gaussians.opacities.requires_grad_()
        out = pixel(gaussians, backend, settings=RasterSettings(alpha_max=0.6))
        assert out.alphas.item() == pytest.approx(shown, rel=1e-5)
        out.alphas.sum().backward()
        assert gaussians.opacities.grad is not None
        assert gaussians.opacities.grad.item() == pytest.approx(slope, rel=1e-5)
    assert alpha(on_the_axis([2.0], [1.0]), backend) == pytest.approx(0.99, rel=1e-6)


def test_a_pixel_that_has_ended_stays_as_it_is(backend: str):
    # 1 - 0.5 = 0.5, then 0.5 * 0.01 = 0.005: below 0.01, so the second ends the pixel, undrawn.
    # The third would leave 0.25, but comes too late.
    three = on_the_axis([2.0, 3.0, 4.0], [0.5, 0.99, 0.5])
    assert alpha(three, backend, settings=RasterSettings(transmittance_min=0.01)) == pytest.approx(
        0.5, rel=1e-6
    )
    # What leaves the limit itself, or less, ends the pixel.
    at_limit = RasterSettings(transmittance_min=0.5)
    assert alpha(on_the_axis([2.0], [0.5]), backend, settings=at_limit) == 0
    # By default 1e-4: 0.01 * 0.05 = 5e-4 is above, times 0.05 below.
    out = alpha(on_the_axis([2.0, 3.0, 4.0], [0.99, 0.95, 0.95]), backend)
    assert out == pytest.approx(1 - 5e-4, abs=1e-6)


def test_a_colour_below_black_is_black_without_a_gradient(backend: str):
    gaussians = on_the_axis([2.0], [0.5], colors=[(-0.5, 2.0, 0.25)])
    gaussians.sh.requires_grad_()
    colors = pixel(gaussians, backend).colors[0, :, 0, 0]
    assert colors.tolist() == pytest.approx([0.0, 1.0, 0.125], abs=1e-6)
    colors.sum().backward()
    assert gaussians.sh.grad is not None
    slope = 0.5 * SH_CONSTANT
    assert gaussians.sh.grad[0, 0].tolist() == pytest.approx([0, slope, slope], rel=1e-5)


def test_the_nearer_is_in_front_and_at_one_depth_the_first(backend: str):
    red_and_blue = [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)]
    beyond = torch.nextafter(torch.tensor(2.0), torch.tensor(3.0)).item()
    for depths, shown in (((2.0, 2.0), [0.5, 0, 0.25]), ((beyond, 2.0), [0.25, 0, 0.5])):
        both = on_the_axis(depths, [0.5, 0.5], colors=red_and_blue)
        colors = pixel(both, backend).colors[0, :, 0, 0]
        assert colors.tolist() == pytest.approx(shown, abs=1e-6)


def test_quaternions_of_any_length_are_turns(backend: str):
    def run(length: float):
        gaussians = on_the_axis([2.0], [0.9])
        gaussians.scales[0] = torch.tensor([0.5, 0.1, 0.3])
        quats = length * torch.tensor([[0.9, 0.1, -0.3, 0.2]])
        gaussians = Gaussians(**{**vars(gaussians), "quats": quats.requires_grad_()})
        out = render(gaussians, camera(center=(1.0, 3.0)), 5, 6, backend=backend)
        (out.alphas[0] * torch.arange(30.0).view(5, 6)).sum().backward()
        assert quats.grad is not None
        return out.alphas.detach(), quats.grad

    alphas, gradient = run(1.0)
    assert gradient.abs().min() > 0.1
    longer_alphas, longer_gradient = run(4.0)
    torch.testing.assert_close(longer_alphas, alphas)
    torch.testing.assert_close(4 * longer_gradient, gradient, rtol=1e-4, atol=1e-4)
    assert (gradient @ torch.tensor([0.9, 0.1, -0.3, 0.2])).abs().item() < 1e-3


def test_an_alpha_is_exact_to_a_millionth(backend: str):
    opacities = torch.linspace(0.004, 0.989, 60)
    one = on_the_axis([2.0], [0.5])
    many = one.batched().map(lambda v: v.repeat(60, *[1] * (v.ndim - 1)))
    many = Gaussians(**{**vars(many), "opacities": opacities[:, None]})
    views = Cameras(*(v.expand(60, *v.shape) for v in vars(camera()).values()))
    found = render(many, views, 1, 1, backend=backend).alphas.flatten()
    # 1 - (1 - alpha), which is what is kept, loses the digits below 6e-8.
    torch.testing.assert_close(found, opacities, rtol=1e-6, atol=1.2e-7)


def test_intrinsics_and_background_have_no_gradient(backend: str):
    view = camera()
    view.intrinsics.requires_grad_()
    background = torch.ones(3, requires_grad=True)
    out = render(on_the_axis([2.0], [0.5]), view, 2, 2, background=background, backend=backend)
    assert not out.colors.requires_grad


@pytest.mark.parametrize("dtype", [torch.int16, torch.int32])
def test_anchors_are_counted_by_any_whole_numbers(backend: str, dtype: torch.dtype):
    gaussians = on_the_axis([2.0, 3.0], [0.5, 0.5])
    numbers = torch.tensor([2, 1])
    features = torch.tensor([[7.0], [8.0], [16.0]])
    gaussians = Gaussians(**{**vars(gaussians), "anchor_index": numbers.to(dtype)})
    maps = pixel(gaussians, backend, anchor_features=features).features
    assert maps is not None
    assert maps.item() == pytest.approx(0.5 * 16 + 0.25 * 8, rel=1e-6)
