"""Photometric alignment of matches (Lucas and Kanade, 1981).

Descriptors locate a match to about a pixel anywhere in the image. The photos locate it to a tenth
of a pixel, but only from a good initial value. Once cameras and depth are roughly known, each match
is aligned from the position that they predict. Its precision comes from the image gradients: high
across an edge, low along it.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from instok3d.backbones.nano.bundle_problem import CONFIDENCE_MIN, NEAREST
from instok3d.backbones.nano.matching import MATCH_STRIDE, Matches
from instok3d.backbones.nano.native_kernels import kernels_for, required_kernels
from instok3d.backbones.nano.threads import all_threads
from instok3d.geometry.cameras import invert_rigid, pixel_centers, transform_points

PATCH = 8
"""Side of a patch in pixels; even, because the centre of a cell is the corner of four pixels."""
PATCH_REACH_PX = 4.0
"""Standard deviation of the Gaussian window over the patch."""
COLOR_NOISE = 0.004
"""Standard deviation of a colour in [0, 1]. Residuals are robust (Cauchy): a noisier photo gets
matches of lower precision."""
CORRELATED_PIXELS = 8.0
"""Number of pixels that carry the information of one independent pixel: errors of neighbouring
pixels correlate."""
PEAK_REACH_PX = 4.0
"""Standard deviation of the prior on the position, around the descriptors' peak."""
NEAREST_ERROR_PX = 0.15
"""Lower bound on the standard deviation of a match."""
START_REACH_PX = 6.0
"""Largest distance between the predicted position and the peak. Beyond it the search starts at the
peak."""
WARP_MAX_PX = 12.0
"""Patches that the warp would extend farther than this from their centre are not warped."""
ITERATIONS = 6


@dataclass(frozen=True)
class PhotoGeometry:
    """Photos of one view of each scene, with the current estimate of their geometry."""

    images: Float[Tensor, "batch 3 height width"]
    depths: Float[Tensor, "batch height width"]
    intrinsics: Float[Tensor, "batch 3 3"]
    cam_from_first: Float[Tensor, "batch 4 4"]


@torch.no_grad()
def align_matches(matches: Matches, here: PhotoGeometry, there: PhotoGeometry) -> Matches:
    """Matches at the positions where the photos agree best, with their precision.

    1. Predict each match from cameras and depth, and warp the patch around its cell accordingly.
    2. Minimise the colour difference over the position by Gauss-Newton, up to one constant for the
       whole patch, because exposures differ.
    3. A prior at the descriptors' peak holds the position where the patch has no texture.

    Matches of low confidence are unchanged. Not differentiable.

    Args:
        matches: Matches of cells of `here` in `there`.
        here: The view whose cells are matched.
        there: The view in which they are searched.
    """
    native = kernels_for(here.images, there.images, matches.pixels)
    search = search_reference if native is None else search_native
    return search(matches, here, there)


def search_native(matches: Matches, here: PhotoGeometry, there: PhotoGeometry) -> Matches:
    """`search_reference` in C++, for float32 on the CPU.

    Uses all threads, also inside of `one_thread`. The result does not depend on their number.

    Raises:
        RuntimeError: The kernels are not built.
    """
    kernels = required_kernels()
    there_from_here = there.cam_from_first @ invert_rigid(here.cam_from_first)
    warps = there.intrinsics @ there_from_here[:, :3, :3] @ here.intrinsics.inverse()
    shifts = (there.intrinsics @ there_from_here[:, :3, 3:])[..., 0]
    depths = sample_depth(here.depths, matches.centers.expand(len(here.depths), -1, -1))
    # Copies, which the kernels write to; contiguous, which those of permuted tensors are not.
    pixels = matches.pixels.clone(memory_format=torch.contiguous_format)
    precision = matches.precision.clone(memory_format=torch.contiguous_format)
    window = _window(_own_offsets(like=matches.centers)).view(PATCH, PATCH)
    with all_threads():
        kernels.align(
            *(
                values.detach().contiguous()
                for values in (here.images, there.images, matches.centers, depths, matches.pixels,
                               matches.confidence, warps, shifts, window)
            ),
            pixels,
            precision,
            nearest=NEAREST,
            largest_warp=WARP_MAX_PX,
            start_reach=START_REACH_PX,
            peak_reach=PEAK_REACH_PX,
            nearest_error=NEAREST_ERROR_PX,
            color_noise=COLOR_NOISE,
            shared=CORRELATED_PIXELS,
            least_confidence=CONFIDENCE_MIN,
            iterations=ITERATIONS,
            threads=torch.get_num_threads(),
        )  # fmt: skip
    return replace(matches, pixels=pixels, precision=precision)


def search_reference(matches: Matches, here: PhotoGeometry, there: PhotoGeometry) -> Matches:
    """The search of `align_matches` on any device and in any precision.

    Args:
        matches: As in `align_matches`.
        here: As in `align_matches`.
        there: As in `align_matches`.
    """
    start, offsets = _warp_patches(matches, here, there)
    own = _own_offsets(like=start)
    window = _window(own)
    patch = _sample(here.images, matches.centers[:, None].expand(len(start), -1, 1, 2) + own)
    layers = torch.cat([there.images, *_image_gradients(there.images)], dim=1)
    prior = torch.eye(2).to(start) / PEAK_REACH_PX**2
    pixels, precision = start, prior.expand(*start.shape, 2)
    for _ in range(ITERATIONS):
        hessian, gradient = _photo_equations(pixels, offsets, patch, layers, window)
        precision = hessian + prior
        gradient = gradient + (pixels - matches.pixels) / PEAK_REACH_PX**2
        step = -(_inverse(precision) @ gradient[..., None])[..., 0]
        pixels = pixels + step / step.norm(dim=-1, keepdim=True).clamp_min(1.0)
    floor = NEAREST_ERROR_PX**2 * torch.eye(2).to(start)
    precision = _inverse(_inverse(precision) + floor)
    sure = (matches.confidence > CONFIDENCE_MIN)[..., None]
    return replace(
        matches,
        pixels=torch.where(sure, pixels, matches.pixels),
        precision=torch.where(sure[..., None], precision, matches.precision),
    )


def _own_offsets(*, like: Tensor) -> Float[Tensor, "pixel 2"]:
    """Pixels of an unwarped patch, relative to its centre."""
    return pixel_centers(PATCH, PATCH, like=like).flatten(0, 1) - 0.5 * PATCH


def _window(offsets: Float[Tensor, "pixel 2"]) -> Float[Tensor, " pixel"]:
    """Weight of each pixel of a patch."""
    return torch.exp(-0.5 * offsets.square().sum(-1) / PATCH_REACH_PX**2)


def _warp_patches(
    matches: Matches, here: PhotoGeometry, there: PhotoGeometry
) -> tuple[Float[Tensor, "batch cell 2"], Float[Tensor, "batch cell pixel 2"]]:
    """Initial positions in the other photo, and the warped patches relative to them.

    Each patch is assumed to be fronto-parallel, at the depth of its cell.
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
    projected = (seen[..., :2] / seen[..., 2:].clamp_min(NEAREST)).unflatten(1, pixels.shape[:2])
    center = projected.mean(2)
    offsets = projected - center[:, :, None]
    small = front & (offsets.abs().amax((2, 3)) < WARP_MAX_PX)
    near = front & ((center - matches.pixels).norm(dim=-1) < START_REACH_PX)
    return (
        torch.where(near[..., None], center, matches.pixels),
        torch.where(small[..., None, None], offsets, own),
    )


# No shape checks on the three functions below: they run so often that, in tests, the checks would
# take longer than the computation.


def _photo_equations(
    pixels: Tensor, offsets: Tensor, patch: Tensor, layers: Tensor, window: Tensor
) -> tuple[Tensor, Tensor]:
    """Normal equations of the whitened colour differences, over the position.

    Args:
        pixels: Current positions, [batch cell 2].
        offsets: Pixels of the warped patches relative to them, [batch cell pixel 2].
        patch: Colours of the patches, [batch 3 cell pixel].
        layers: Colours of the other photo and their gradients in x and y, [batch 9 row column].
        window: Weight of each pixel of a patch.

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
    robust = robust / (CORRELATED_PIXELS * COLOR_NOISE**2)

    def total(a: Tensor, b: Tensor) -> Tensor:
        return (robust * a * b).sum((1, 3))

    cross = total(by_x, by_y)
    hessian = torch.stack([total(by_x, by_x), cross, cross, total(by_y, by_y)], dim=-1)
    gradient = torch.stack([total(by_x, error), total(by_y, error)], dim=-1)
    return hessian.unflatten(-1, (2, 2)), gradient


def _sample(images: Tensor, pixels: Tensor) -> Tensor:
    """Bilinear samples [batch channel a b] at pixels [batch a b 2]; beyond the edge, its values."""
    size = torch.tensor([images.shape[-1], images.shape[-2]]).to(images)
    return functional.grid_sample(
        images, pixels / size * 2 - 1, padding_mode="border", align_corners=False
    )


def _inverse(matrices: Tensor) -> Tensor:
    """Inverse of symmetric 2 x 2 matrices in closed form: a batched solver is slower."""
    a, b, d = matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 1, 1]
    adjugate = torch.stack([d, -b, -b, a], dim=-1).unflatten(-1, (2, 2))
    return adjugate / (a * d - b * b)[..., None, None]


def sample_depth(
    depths: Float[Tensor, "batch height width"], pixels: Float[Tensor, "batch point 2"]
) -> Float[Tensor, "batch point"]:
    """Depth at positions in the image, interpolated in log depth between the means of cells."""
    coarse = functional.avg_pool2d(depths[:, None].log(), MATCH_STRIDE)
    return _sample(coarse, pixels[:, :, None] / MATCH_STRIDE)[:, 0, :, 0].exp()


def _image_gradients(images: Float[Tensor, "batch 3 height width"]) -> tuple[Tensor, Tensor]:
    """Derivatives of the colours in x and y, by central differences."""
    padded = functional.pad(images, (1, 1, 1, 1), mode="replicate")
    along_x = 0.5 * (padded[..., 1:-1, 2:] - padded[..., 1:-1, :-2])
    along_y = 0.5 * (padded[..., 2:, 1:-1] - padded[..., :-2, 1:-1])
    return along_x, along_y
