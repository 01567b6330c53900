"""The definition of the rasterizer in plain PyTorch: any dtype, any device, dense and slow.

Every pixel looks at every Gaussian; the fast backends are tested against this one.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional
from torch.utils.checkpoint import checkpoint

from instok3d.geometry.cameras import pixel_centers, transform_points
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.geometry.spherical_harmonics import evaluate_sh
from instok3d.render.settings import RasterSettings
from instok3d.types import Cameras, Gaussians, Rendering

PAIRS_IN_MEMORY = 2**22
"""Pixel x Gaussian pairs that are worked on at a time."""


@dataclass(frozen=True)
class Projected:
    """Gaussians as one camera sees them."""

    means2d: Float[Tensor, "gaussian 2"]
    """Pixels."""
    conics: Float[Tensor, "gaussian 3"]
    """Entries xx, xy, yy of the inverse 2D covariance, 1 / square pixel."""
    depths: Float[Tensor, " gaussian"]
    """z in the camera's frame, scene units."""
    inside: Bool[Tensor, " gaussian"]
    """Between near and far, with finite numbers and an invertible covariance."""

    def rows(self, index: Int[Tensor, " chosen"]) -> "Projected":
        """Some of them, in the order of the indices."""
        return Projected(**{name: value[index] for name, value in vars(self).items()})


def render_reference(
    gaussians: Gaussians,
    cameras: Cameras,
    height: int,
    width: int,
    *,
    anchor_features: Float[Tensor, "batch anchor channel"] | None,
    background: Float[Tensor, " 3"],
    near: float,
    far: float,
    settings: RasterSettings,
) -> Rendering:
    """Pictures of a batch of scenes; the arguments are those of `instok3d.render.render`.

    Differentiable in everything but the anchor indices. The order of the Gaussians and the
    thresholds of the settings are treated as constant.
    """
    pictures = []
    for scene in range(gaussians.means.shape[0]):
        for view in range(cameras.intrinsics.shape[1]):
            values = _render_view(
                gaussians.scene(scene),
                cameras.cam_from_world[scene, view],
                cameras.intrinsics[scene, view],
                (height, width),
                anchor_features[scene] if anchor_features is not None else None,
                (near, far),
                settings,
            )
            pictures.append(values)
    channels = 5 + (anchor_features.shape[-1] if anchor_features is not None else 0)
    shape = (*cameras.intrinsics.shape[:2], channels, height, width)
    picture = torch.stack(pictures).view(shape) if pictures else gaussians.means.new_zeros(shape)
    alphas = picture[:, :, 4]
    hit = alphas > 0
    return Rendering(
        colors=picture[:, :, :3] + (1 - alphas)[:, :, None] * background[:, None, None],
        alphas=alphas,
        depths=torch.where(hit, picture[:, :, 3] / torch.where(hit, alphas, 1), 0),
        features=picture[:, :, 5:] if anchor_features is not None else None,
    )


def project_gaussians(
    means: Float[Tensor, "gaussian 3"],
    quats: Float[Tensor, "gaussian 4"],
    scales: Float[Tensor, "gaussian 3"],
    cam_from_world: Float[Tensor, "4 4"],
    intrinsics: Float[Tensor, "3 3"],
    height: int,
    width: int,
    *,
    near: float,
    far: float,
    eps2d: float,
) -> Projected:
    """EWA projection: the covariance goes through the Jacobian of the pinhole at the mean.

    As in gsplat, the Jacobian is taken no further out than 0.3 of the half image beyond its
    border, where it would grow without bound.
    """
    mean_in_cam = transform_points(cam_from_world, means)
    axes_in_cam = cam_from_world[:3, :3] @ quat_to_matrix(quats) * scales[:, None, :]
    depths = mean_in_cam[:, 2]
    between = (depths > near) & (depths < far)
    z = torch.where(between, depths, torch.ones_like(depths))
    slope = mean_in_cam[:, :2] / z[:, None]
    focal, center = intrinsics.diagonal()[:2], intrinsics[:2, 2]
    size = torch.tensor([width, height], dtype=means.dtype, device=means.device)
    margin = 0.15 * size / focal
    # Two one-sided cuts: torch.clamp gives a tensor bound half of the gradient at the border.
    lowest, highest = -center / focal - margin, (size - center) / focal + margin
    cut_slope = torch.where(slope < lowest, lowest, torch.where(slope > highest, highest, slope))
    scale = focal / z[:, None]
    # Rows of J R S: scale * (axes_xy - slope * axes_z).
    rows = scale[..., None] * (
        axes_in_cam[:, :2] - cut_slope[..., None] * axes_in_cam[:, 2, None, :]
    )
    xx = rows[:, 0].square().sum(-1) + eps2d
    xy = (rows[:, 0] * rows[:, 1]).sum(-1)
    yy = rows[:, 1].square().sum(-1) + eps2d
    determinant = xx * yy - xy * xy
    means2d = slope * focal + center
    conics = torch.stack([yy, -xy, xx], dim=-1) / determinant[:, None]
    finite = means2d.isfinite().all(-1) & conics.isfinite().all(-1)
    return Projected(means2d, conics, depths, between & (determinant > 0) & finite)


def blending_weights(
    projected: Projected,
    opacities: Float[Tensor, " gaussian"],
    pixels: Float[Tensor, "pixel 2"],
    settings: RasterSettings,
) -> Float[Tensor, "pixel gaussian"]:
    """Alpha x transmittance of every Gaussian in every pixel, Gaussians front to back."""
    dx, dy = (projected.means2d - pixels[:, None]).unbind(-1)
    xx, xy, yy = projected.conics.unbind(-1)
    sigma = 0.5 * (xx * dx * dx + yy * dy * dy) + xy * dx * dy
    alpha = (opacities * torch.exp(-sigma)).clamp(max=settings.alpha_max)
    seen = (alpha >= settings.alpha_min) & (sigma >= 0)
    alpha = torch.where(seen, alpha, torch.zeros_like(alpha))
    after = (1 - alpha).cumprod(1)
    before = functional.pad(after[:, :-1], (1, 0), value=1.0)
    return torch.where(after > settings.transmittance_min, alpha * before, 0)


def _render_view(
    gaussians: Gaussians,
    cam_from_world: Float[Tensor, "4 4"],
    intrinsics: Float[Tensor, "3 3"],
    size: tuple[int, int],
    features: Float[Tensor, "anchor channel"] | None,
    near_far: tuple[float, float],
    settings: RasterSettings,
) -> Float[Tensor, "sum {size[0]} {size[1]}"]:
    """Sums of w x (red, green, blue, z, 1, features)."""
    height, width = size

    def project(index: Int[Tensor, " picked"]) -> Projected:
        return project_gaussians(
            gaussians.means[index], gaussians.quats[index], gaussians.scales[index],
            cam_from_world, intrinsics, height, width,
            near=near_far[0], far=near_far[1], eps2d=settings.eps2d,
        )  # fmt: skip

    # Visibility first and without gradients: what is culled can then send no NaN back.
    with torch.no_grad():
        finite = (gaussians.opacities >= settings.alpha_min) & gaussians.opacities.isfinite()
        for value in (gaussians.means, gaussians.quats, gaussians.scales, gaussians.sh.flatten(1)):
            finite = finite & value.isfinite().all(-1)
        index = finite.nonzero()[:, 0]
        seen = project(index)
        index = index[seen.inside]
        index = index[seen.depths[seen.inside].argsort(stable=True)]
    projected = project(index)
    camera_position = -cam_from_world[:3, :3].mT @ cam_from_world[:3, 3]
    directions = functional.normalize(gaussians.means[index] - camera_position, dim=-1)
    colors = functional.relu(evaluate_sh(gaussians.sh[index], directions) + 0.5)
    depths = projected.depths[:, None]
    values = [colors, depths, torch.ones_like(depths)]
    if features is not None:
        values.append(features[gaussians.anchor_index[index]])
    values = torch.cat(values, dim=-1)
    opacities = gaussians.opacities[index]

    def composite(pixels: Float[Tensor, "pixel 2"]) -> Float[Tensor, "pixel channel"]:
        return blending_weights(projected, opacities, pixels, settings) @ values

    pixels = pixel_centers(height, width, like=gaussians.means).view(-1, 2)
    chunks = pixels.split(max(PAIRS_IN_MEMORY // max(len(index), 1), 1))
    if len(chunks) == 1:
        picture = composite(pixels)
    else:  # recomputed chunk by chunk in the backward pass, so that one fits memory
        picture = torch.cat([checkpoint(composite, part, use_reentrant=False) for part in chunks])
    return picture.T.reshape(-1, height, width)
