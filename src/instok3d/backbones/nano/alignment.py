"""Matches moved to where the photos themselves agree.

Descriptors find the place to about a pixel, wherever it is; the photos say it to a tenth of one,
but only near by. Once cameras and depth are roughly known, each match is searched for from where
they put it (Lucas and Kanade, 1981), and how far the photos pin it down, which across an edge is
well and along it not at all, goes with it as its precision.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from instok3d.backbones.nano.bundle import NEAREST, TRUST_MIN
from instok3d.backbones.nano.matching import MATCH_STRIDE, Matches
from instok3d.backbones.nano.threads import all_threads
from instok3d.geometry.cameras import invert_rigid, pixel_centers, transform_points

try:  # after torch, so that both use torch's OpenMP and its pool of threads
    from instok3d.backbones.nano.native import (
        _alignment,  # pyright: ignore[reportAttributeAccessIssue]
    )
except ImportError:
    _alignment = None

PATCH = 8
"""Pixels across the patch that is compared; even, as the middle of a cell is a corner of four."""
PATCH_REACH_PX = 4.0
"""Standard deviation of the weights of the patch's pixels."""
COLOR_NOISE = 0.004
"""Of a colour from 0 to 1. Larger differences count less and less (Cauchy), so a noisier photo
loosens its matches by itself."""
SHARED = 8.0
"""Neighbouring pixels are wrong together: so many of a patch say what one would."""
PEAK_REACH_PX = 4.0
"""Standard deviation about the descriptors' peak within which a place is looked for."""
NEAREST_ERROR_PX = 0.15
"""No match is taken to be surer than this."""
START_REACH_PX = 6.0
"""Where cameras and depth put a match farther from its peak than this, the peak is believed."""
WARP_MAX_PX = 12.0
"""A patch that would grow over more on a side is compared as it is."""
ITERATIONS = 6


@dataclass(frozen=True)
class PhotoGeometry:
    """Photos of one view of each scene, and what is known of their geometry so far."""

    images: Float[Tensor, "batch 3 height width"]
    depths: Float[Tensor, "batch height width"]
    intrinsics: Float[Tensor, "batch 3 3"]
    cam_from_first: Float[Tensor, "batch 4 4"]


@torch.no_grad()
def align_matches(matches: Matches, here: PhotoGeometry, there: PhotoGeometry) -> Matches:
    """The matches where the photos agree best, and how precisely they say so.

    The patch around each cell, turned and scaled as cameras and depth say, is moved over the other
    photo until the colours differ least, apart from one difference for the whole patch, as
    exposures differ. Gauss-Newton from where cameras and depth put it; the descriptors' peak
    holds it where there is nothing to be seen. Cells whose match no scene trusts stay as they
    are. Not differentiable.

    Args:
        matches: Of cells of `here` in `there`.
        here: Where the cells are.
        there: Where they are looked for.
    """
    trusted = (matches.trust > TRUST_MIN).any(0).nonzero()[:, 0]
    plain = all(
        values.dtype == torch.float32 and values.device.type == "cpu"
        for values in (here.images, there.images, matches.pixels)
    )
    search = search_native if _alignment is not None and plain else search_reference
    found = search(matches.at(trusted), here, there)
    return replace(
        matches,
        pixels=matches.pixels.index_copy(1, trusted, found.pixels),
        precision=matches.precision.index_copy(1, trusted, found.precision),
    )


def search_native(matches: Matches, here: PhotoGeometry, there: PhotoGeometry) -> Matches:
    """What `search_reference` does, in C++ for the processor, from float32.

    Uses all threads, inside of `one_thread` too; the result does not depend on how many.

    Raises:
        RuntimeError: The kernels are not built.
    """
    if _alignment is None:
        raise RuntimeError("the kernels of the alignment were not built with instok3d")
    there_from_here = there.cam_from_first @ invert_rigid(here.cam_from_first)
    warps = there.intrinsics @ there_from_here[:, :3, :3] @ here.intrinsics.inverse()
    shifts = (there.intrinsics @ there_from_here[:, :3, 3:])[..., 0]
    depths = sample_depth(here.depths, matches.centers.expand(len(here.depths), -1, -1))
    # Contiguous, which empty_like of a permuted tensor is not: the kernels write to them.
    pixels = matches.pixels.new_empty(matches.pixels.shape)
    precision = matches.precision.new_empty(matches.precision.shape)
    window = _window(_own_offsets(like=matches.centers)).view(PATCH, PATCH)
    with all_threads():
        _alignment.align(
            *(
                values.detach().contiguous()
                for values in (here.images, there.images, matches.centers, depths, matches.pixels,
                               warps, shifts, window)
            ),
            pixels,
            precision,
            nearest=NEAREST,
            largest_warp=WARP_MAX_PX,
            start_reach=START_REACH_PX,
            peak_reach=PEAK_REACH_PX,
            nearest_error=NEAREST_ERROR_PX,
            color_noise=COLOR_NOISE,
            shared=SHARED,
            iterations=ITERATIONS,
            threads=torch.get_num_threads(),
        )  # fmt: skip
    return replace(matches, pixels=pixels, precision=precision)


def search_reference(matches: Matches, here: PhotoGeometry, there: PhotoGeometry) -> Matches:
    """The search of `align_matches`, of all of these matches, on any device and in any precision.

    Args:
        matches: As in `align_matches`.
        here: As in `align_matches`.
        there: As in `align_matches`.
    """
    start, offsets = _warp_patches(matches, here, there)
    own = _own_offsets(like=start)
    window = _window(own)
    patch = _sample(here.images, matches.centers[:, None].expand(len(start), -1, 1, 2) + own)
    layers = torch.cat([there.images, *_slopes(there.images)], dim=1)
    held = torch.eye(2).to(start) / PEAK_REACH_PX**2
    pixels, precision = start, held.expand(*start.shape, 2)
    for _ in range(ITERATIONS):
        hessian, gradient = _photo_equations(pixels, offsets, patch, layers, window)
        precision = hessian + held
        gradient = gradient + (pixels - matches.pixels) / PEAK_REACH_PX**2
        step = -(_inverse(precision) @ gradient[..., None])[..., 0]
        pixels = pixels + step / step.norm(dim=-1, keepdim=True).clamp_min(1.0)
    floor = NEAREST_ERROR_PX**2 * torch.eye(2).to(start)
    return replace(matches, pixels=pixels, precision=_inverse(_inverse(precision) + floor))


def _own_offsets(*, like: Tensor) -> Float[Tensor, "pixel 2"]:
    """The pixels of a patch about its middle."""
    return pixel_centers(PATCH, PATCH, like=like).flatten(0, 1) - 0.5 * PATCH


def _window(offsets: Float[Tensor, "pixel 2"]) -> Float[Tensor, " pixel"]:
    """Weights of the pixels of a patch."""
    return torch.exp(-0.5 * offsets.square().sum(-1) / PATCH_REACH_PX**2)


def _warp_patches(
    matches: Matches, here: PhotoGeometry, there: PhotoGeometry
) -> tuple[Float[Tensor, "batch cell 2"], Float[Tensor, "batch cell pixel 2"]]:
    """Where to begin in the other photo, and the patch's pixels about that place.

    Each patch is taken to face the camera at the depth of its cell.
    """
    own = _own_offsets(like=matches.centers)
    pixels = matches.centers[:, None] + own
    rays = torch.cat([pixels, torch.ones_like(pixels[..., :1])], dim=-1).flatten(0, 1)
    depth = sample_depth(here.depths, matches.centers.expand(len(here.depths), -1, -1))
    depth = depth.repeat_interleave(PATCH**2, dim=1)
    points = rays @ here.intrinsics.inverse().mT * depth[..., None]
    seen = transform_points(there.cam_from_first @ invert_rigid(here.cam_from_first), points)
    front = (seen[..., 2] > NEAREST).unflatten(1, pixels.shape[:2]).all(-1)
    seen = seen @ there.intrinsics.mT
    placed = (seen[..., :2] / seen[..., 2:].clamp_min(NEAREST)).unflatten(1, pixels.shape[:2])
    middle = placed.mean(2)
    offsets = placed - middle[:, :, None]
    small = front & (offsets.abs().amax((2, 3)) < WARP_MAX_PX)
    near = front & ((middle - matches.pixels).norm(dim=-1) < START_REACH_PX)
    return (
        torch.where(near[..., None], middle, matches.pixels),
        torch.where(small[..., None, None], offsets, own),
    )


# The three below run so often that checking their types takes longer than small photos do.


def _photo_equations(
    pixels: Tensor, offsets: Tensor, patch: Tensor, layers: Tensor, window: Tensor
) -> tuple[Tensor, Tensor]:
    """Normal equations of the colour differences over the place, in units of their noise.

    Args:
        pixels: Places so far, [batch cell 2].
        offsets: Of the patch's pixels about them, [batch cell pixel 2].
        patch: Colours to be found, [batch 3 cell pixel].
        layers: Colours of the other photo, their slopes along x and along y, [batch 9 row column].
        window: Weights of the patch's pixels.

    Returns:
        Hessian [batch cell 2 2] and gradient [batch cell 2].
    """
    found = _sample(layers, pixels[:, :, None] + offsets)
    weights = window / window.sum()
    found = torch.cat([found[:, :3] - patch, found[:, 3:]], dim=1)
    found = found - (found * weights).sum(-1, keepdim=True)
    error, by_x, by_y = found.split(3, dim=1)
    scale = 2 * COLOR_NOISE
    robust = window / (1 + error.square().mean(1, keepdim=True) / scale**2)
    robust = robust / (SHARED * COLOR_NOISE**2)

    def total(a: Tensor, b: Tensor) -> Tensor:
        return (robust * a * b).sum((1, 3))

    cross = total(by_x, by_y)
    hessian = torch.stack([total(by_x, by_x), cross, cross, total(by_y, by_y)], dim=-1)
    gradient = torch.stack([total(by_x, error), total(by_y, error)], dim=-1)
    return hessian.unflatten(-1, (2, 2)), gradient


def _sample(images: Tensor, pixels: Tensor) -> Tensor:
    """Values [batch channel a b] at places [batch a b 2], bilinear; outside those of the edge."""
    size = torch.tensor([images.shape[-1], images.shape[-2]]).to(images)
    return functional.grid_sample(
        images, pixels / size * 2 - 1, padding_mode="border", align_corners=False
    )


def _inverse(matrices: Tensor) -> Tensor:
    """Of symmetric positive definite 2 x 2, written out: many small ones are slow otherwise."""
    a, b, d = matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 1, 1]
    adjugate = torch.stack([d, -b, -b, a], dim=-1).unflatten(-1, (2, 2))
    return adjugate / (a * d - b * b)[..., None, None]


def sample_depth(
    depths: Float[Tensor, "batch height width"], pixels: Float[Tensor, "batch point 2"]
) -> Float[Tensor, "batch point"]:
    """Depth at places of the image; that of a cell is the geometric mean over its pixels."""
    coarse = functional.avg_pool2d(depths[:, None].log(), MATCH_STRIDE)
    return _sample(coarse, pixels[:, :, None] / MATCH_STRIDE)[:, 0, :, 0].exp()


def _slopes(images: Float[Tensor, "batch 3 height width"]) -> tuple[Tensor, Tensor]:
    """Change of colour from pixel to pixel along x and along y."""
    padded = functional.pad(images, (1, 1, 1, 1), mode="replicate")
    along_x = 0.5 * (padded[..., 1:-1, 2:] - padded[..., 1:-1, :-2])
    along_y = 0.5 * (padded[..., 2:, 1:-1] - padded[..., :-2, 1:-1])
    return along_x, along_y
