"""Matches found again in the photos: shifts, edges, blank walls, exposure, zoom, borders."""

from dataclasses import replace

import pytest
import torch
from torch.nn import functional

from instok3d.backbones.nano.alignment import (
    NEAREST_ERROR_PX,
    PEAK_REACH_PX,
    PhotoGeometry,
    align_matches,
    sample_depth,
    search_native,
    search_reference,
)
from instok3d.backbones.nano.matching import MATCH_STRIDE, Matches, cell_centers
from instok3d.render import native_status

SIZE = 64
INTRINSICS = torch.tensor([[[60.0, 0, 32], [0, 60.0, 32], [0, 0, 1]]])
HELD = 1 / PEAK_REACH_PX**2
"""Precision of a match that the photos say nothing of, before the floor of 0.15 pixels."""


def photo(shift: tuple[float, float] = (0.0, 0.0), *, zoom: float = 1.0) -> torch.Tensor:
    """A smooth pattern; what lies at x in the plain one lies at 32 + zoom (x - 32) + shift."""
    place = torch.arange(SIZE) + 0.5 - 32
    x = ((place - shift[0]) / zoom)[None, :]
    y = ((place - shift[1]) / zoom)[:, None]
    waves = [
        0.5 + 0.2 * torch.sin(0.55 * x + 0.2 * y) + 0.2 * torch.cos(0.43 * y - 0.15 * x),
        0.5 + 0.3 * torch.sin(0.33 * x - 0.5 * y),
        0.5 + 0.3 * torch.cos(0.4 * x + 0.37 * y),
    ]
    return torch.stack(waves)[None]


def view(image: torch.Tensor, cam_from_first: torch.Tensor | None = None) -> PhotoGeometry:
    """A wall two units in front of a camera."""
    camera = torch.eye(4)[None] if cam_from_first is None else cam_from_first
    return PhotoGeometry(image, torch.full((1, SIZE, SIZE), 2.0), INTRINSICS, camera)


def moved(x: float, z: float = 0.0) -> torch.Tensor:
    camera = torch.eye(4)[None].clone()
    camera[0, 0, 3], camera[0, 2, 3] = x, z
    return camera


def peaks(error: tuple[float, float] = (0.0, 0.0)) -> Matches:
    """Every cell at its own place, wrong by some pixels."""
    side = SIZE // MATCH_STRIDE
    centers = cell_centers(side, side, like=torch.zeros(1))
    pixels = centers[None] + torch.tensor(error)
    precision = torch.eye(2).expand(1, len(centers), 2, 2)
    return Matches(centers, pixels, precision, torch.ones(1, len(centers)))


def inner(values: torch.Tensor) -> torch.Tensor:
    """Those of the cells whose patch and search stay inside the image."""
    side = SIZE // MATCH_STRIDE
    return values.unflatten(1, (side, side))[:, 3:-3, 3:-3].flatten(1, 2)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.4, -0.3), (1.7, 1.2), (-2.2, 0.5)])
def test_a_shift_between_pixels_is_found(shift):
    found = align_matches(peaks(), view(photo()), view(photo(shift)))
    error = inner(found.pixels - peaks(shift).pixels).norm(dim=-1)
    assert error.median() < 0.05
    assert error.quantile(0.95) < 0.25
    assert inner(found.precision)[..., 0, 0].median() > 4


def test_no_match_is_surer_than_its_floor():
    found = align_matches(peaks(), view(photo()), view(photo()))
    assert torch.linalg.eigvalsh(found.precision).max() <= 1.001 / NEAREST_ERROR_PX**2


def test_a_blank_wall_leaves_the_peak_and_knows_that_it_knows_nothing():
    blank = torch.full((1, 3, SIZE, SIZE), 0.5)
    found = align_matches(peaks((1.0, -2.0)), view(blank), view(blank))
    torch.testing.assert_close(found.pixels, peaks((1.0, -2.0)).pixels, atol=1e-3, rtol=0)
    held = torch.eye(2) / (1 / HELD + NEAREST_ERROR_PX**2)
    torch.testing.assert_close(found.precision, held.expand_as(found.precision))


def test_an_edge_tells_across_and_not_along():
    edge = torch.sigmoid((torch.arange(SIZE) + 0.5 - 30) / 1.5).expand(1, 3, SIZE, SIZE)
    found = align_matches(peaks((1.0, 0.7)), view(edge), view(edge))
    at_edge = (found.centers[:, 0] == 30.0) & ((found.centers[:, 1] - 32).abs() < 16)
    # Up and down it stays at the peak, 0.7 pixels off; across it comes back to its place.
    off = (found.pixels[0] - found.centers)[at_edge]
    torch.testing.assert_close(off[:, 1], torch.full_like(off[:, 1], 0.7), atol=0.02, rtol=0)
    assert off[:, 0].abs().max() < 0.1
    known = found.precision[0, at_edge]
    assert (known[:, 0, 0] > 20 * known[:, 1, 1]).all()
    torch.testing.assert_close(known[:, 1, 1], torch.full_like(off[:, 1], HELD), rtol=0.05, atol=0)


def test_another_exposure_changes_nothing():
    plain = align_matches(peaks(), view(photo()), view(photo((0.6, 0.4))))
    brighter = align_matches(peaks(), view(photo()), view(photo((0.6, 0.4)) + 0.1))
    torch.testing.assert_close(brighter.pixels, plain.pixels, atol=1e-3, rtol=0)


def test_noise_loosens_the_matches_by_itself(rng):
    faint = 0.5 + 0.2 * (photo() - 0.5)
    noise = 0.03 * torch.randn(1, 3, SIZE, SIZE, generator=rng)
    clean = align_matches(peaks(), view(faint), view(faint))
    noisy = align_matches(peaks(), view(faint), view(faint + noise))
    spread_clean, spread_noisy = (
        inner(each.precision.inverse())[..., 0, 0] - NEAREST_ERROR_PX**2 for each in (clean, noisy)
    )
    # Slopes of the noise itself count as something to be seen, so not by all that it should.
    assert (spread_noisy / spread_clean).median() > 1.5
    error = inner(noisy.pixels - peaks().pixels).norm(dim=-1)
    assert 0.1 < error.median() < 1.0


def test_cameras_and_depth_say_where_to_begin():
    # 0.12 to the left at depth 2: 3.6 pixels. A peak that is wrong by as much is let go of.
    there = view(photo((-3.6, 0.0)), moved(-0.12))
    found = align_matches(peaks(), view(photo()), there)
    error = inner(found.pixels - peaks((-3.6, 0.0)).pixels).norm(dim=-1)
    assert error.median() < 0.05


def test_a_nearer_camera_sees_the_patch_larger():
    # From 2 to 1.6 units: 1.25 times as large. Without the warp the patches do not fit.
    there = view(photo(zoom=1.25), moved(0.0, -0.4))
    centers = peaks().centers
    right = (32 + 1.25 * (centers - 32))[None]
    start = replace(peaks(), pixels=right + 0.5)
    fitted = align_matches(start, view(photo()), there)
    unwarped = align_matches(start, view(photo()), replace(there, cam_from_first=moved(0.0)))
    visible = inner((right - 32).abs().amax(-1, keepdim=True) < 20)[0, :, 0]
    errors = [inner(each.pixels - right)[0, visible].norm(dim=-1) for each in (fitted, unwarped)]
    assert errors[0].median() < 0.05
    assert errors[0].mean() < 0.5 * errors[1].mean()


def test_behind_the_camera_and_far_outside_all_stays_finite():
    behind = moved(0.0, -5.0)
    for camera, start in ((behind, peaks()), (moved(0.0), peaks((500.0, -300.0)))):
        found = align_matches(start, view(photo()), view(photo(), camera))
        assert found.pixels.isfinite().all()
        assert found.precision.isfinite().all()
        assert (torch.linalg.eigvalsh(found.precision) > 0).all()


needs_kernels = pytest.mark.skipif(
    not native_status().available, reason=f"native kernels: {native_status().reason}"
)


def noisy_pair(rng: torch.Generator) -> tuple[Matches, PhotoGeometry, PhotoGeometry]:
    """Two scenes of two unlike rough photos each, of unlike sizes, and cells all over them."""
    turned = torch.eye(4).repeat(2, 1, 1)
    turned[:, :3, :3] = torch.linalg.matrix_exp(
        torch.tensor([[0.0, -0.1, 0.05], [0.1, 0, 0.02], [-0.05, -0.02, 0]])
    )
    turned[1, 2, 3] = -2.05  # part of the second wall lies behind the camera
    rough = functional.interpolate(torch.rand(4, 3, 16, 16, generator=rng), size=(64, 96))
    here, there = rough[:2, :, :48, :64].contiguous(), rough[2:]
    depths = 1.8 + 0.4 * torch.rand(2, 48, 64, generator=rng)
    intrinsics = INTRINSICS.repeat(2, 1, 1)
    centers = cell_centers(12, 16, like=torch.zeros(1))
    pixels = centers + 3 * torch.randn(2, len(centers), 2, generator=rng)
    precision = torch.eye(2).expand(2, len(centers), 2, 2)
    return (
        Matches(centers, pixels, precision, torch.ones(2, len(centers))),
        PhotoGeometry(here, depths, intrinsics, torch.eye(4).repeat(2, 1, 1)),
        PhotoGeometry(there, torch.full((2, 64, 96), 2.0), intrinsics, turned),
    )


@needs_kernels
def test_the_kernels_find_what_the_reference_finds(rng):
    matches, here, there = noisy_pair(rng)
    fast, exact = search_native(matches, here, there), search_reference(matches, here, there)
    off = (fast.pixels - exact.pixels).norm(dim=-1).flatten()
    assert (exact.pixels - matches.pixels).norm(dim=-1).median() > 0.5
    # Where two places fit equally well, rounding may choose.
    assert off.median() < 1e-4
    assert off.quantile(0.99) < 1e-2
    same = (off < 1e-3).view(2, -1)
    torch.testing.assert_close(fast.precision[same], exact.precision[same], rtol=0.02, atol=1e-3)


@pytest.mark.parametrize(
    "search", [search_reference, pytest.param(search_native, marks=needs_kernels)]
)
def test_unsure_matches_stay_scene_by_scene(rng, search):
    matches, here, there = noisy_pair(rng)
    every = search(matches, here, there)
    confidence = torch.where(torch.rand(matches.confidence.shape, generator=rng) < 0.5, 0.5, 0.9)
    found = search(replace(matches, confidence=confidence), here, there)
    sure = confidence > 0.5
    assert not torch.equal(sure[0], sure[1])
    for name in ("pixels", "precision"):
        ours, given, aligned = (vars(each)[name] for each in (found, matches, every))
        assert torch.equal(ours[~sure], given[~sure])
        assert torch.equal(ours[sure], aligned[sure])
        assert not torch.equal(aligned[~sure], given[~sure])


@needs_kernels
def test_the_layout_of_the_matches_changes_nothing(rng):
    matches, here, there = noisy_pair(rng)
    plain = search_native(matches, here, there)
    # Dense, but not in order: what is made like these is not in order, either.
    turned = replace(
        matches,
        pixels=matches.pixels.mT.contiguous().mT,
        precision=matches.precision.transpose(1, 3).contiguous().transpose(1, 3),
    )
    found = search_native(turned, here, there)
    assert torch.equal(found.pixels, plain.pixels)
    assert torch.equal(found.precision, plain.precision)


@needs_kernels
def test_the_kernels_give_the_same_bytes_on_any_number_of_threads(rng):
    found, before = [], torch.get_num_threads()
    for threads in (1, 2, 3):
        torch.set_num_threads(threads)
        found.append(search_native(*noisy_pair(rng.manual_seed(5))))
    torch.set_num_threads(before)
    for other in found[1:]:
        assert torch.equal(other.pixels, found[0].pixels)
        assert torch.equal(other.precision, found[0].precision)


@needs_kernels
def test_the_kernels_survive_places_that_are_no_numbers(rng):
    matches, here, there = noisy_pair(rng)
    broken = torch.full_like(there.cam_from_first, float("nan"))
    found = search_native(matches, here, replace(there, cam_from_first=broken))
    # Neither in front nor behind: the peak is believed.
    assert found.pixels.isfinite().all()
    far = replace(matches, pixels=torch.full_like(matches.pixels, float("nan")))
    assert search_native(far, here, there).pixels.shape == matches.pixels.shape


def test_double_precision_goes_to_the_reference(rng):
    matches, here, there = noisy_pair(rng)
    matches, here, there = (
        replace(each, **{name: value.double() for name, value in vars(each).items()})
        for each in (matches, here, there)
    )
    found, exact = align_matches(matches, here, there), search_reference(matches, here, there)
    assert found.pixels.dtype == torch.float64
    assert torch.equal(found.pixels, exact.pixels)


def test_no_cells_are_no_matches():
    nothing = peaks().at(torch.zeros(0, dtype=torch.long))
    found = align_matches(nothing, view(photo()), view(photo()))
    assert found.pixels.shape == (1, 0, 2)
    assert found.precision.shape == (1, 0, 2, 2)


def test_depth_of_a_cell_is_the_geometric_mean_of_its_pixels():
    depths = torch.tensor([1.0, 4.0]).repeat(2).expand(1, 4, 4)
    depths = functional.pad(depths, (0, 4, 0, 4), value=8.0)
    pixels = torch.tensor([[[2.0, 2.0], [6.0, 6.0], [4.0, 2.0]]])
    # Between two cells it is interpolated in the logarithm: sqrt(2 * 8).
    torch.testing.assert_close(sample_depth(depths, pixels), torch.tensor([[2.0, 8.0, 4.0]]))
