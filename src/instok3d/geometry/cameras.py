"""Pinhole cameras in OpenCV axes: project, unproject, invert, resize."""

import torch
from jaxtyping import Float
from torch import Tensor


def pixel_centers(height: int, width: int, *, like: Tensor) -> Float[Tensor, "{height} {width} 2"]:
    """Pixel coordinates (x, y) of the centre of every pixel, in the dtype and device of `like`."""
    y = torch.arange(height, dtype=like.dtype, device=like.device) + 0.5
    x = torch.arange(width, dtype=like.dtype, device=like.device) + 0.5
    return torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)


def pixel_rays(
    intrinsics: Float[Tensor, "*batch 3 3"], height: int, width: int
) -> Float[Tensor, "*batch {height} {width} 3"]:
    """Directions through the pixel centres in the camera's frame, scaled so that z = 1."""
    pixels = pixel_centers(height, width, like=intrinsics)
    focal = torch.stack([intrinsics[..., 0, 0], intrinsics[..., 1, 1]], dim=-1)
    center = intrinsics[..., :2, 2]
    xy = (pixels - center[..., None, None, :]) / focal[..., None, None, :]
    return torch.cat([xy, torch.ones_like(xy[..., :1])], dim=-1)


def unproject(
    depths: Float[Tensor, "*batch height width"], intrinsics: Float[Tensor, "*batch 3 3"]
) -> Float[Tensor, "*batch height width 3"]:
    """Points behind the pixels, in each camera's own frame, in the units of the z-depths."""
    height, width = depths.shape[-2:]
    return pixel_rays(intrinsics, height, width) * depths[..., None]


def project(
    points: Float[Tensor, "*batch point 3"], intrinsics: Float[Tensor, "*batch 3 3"]
) -> Float[Tensor, "*batch point 2"]:
    """Pixel coordinates of points given in the camera's frame.

    Points on or behind the camera plane give non-finite or mirrored pixels: test z > 0 first.
    """
    homogeneous = points @ intrinsics.mT
    return homogeneous[..., :2] / homogeneous[..., 2:]


def transform_points(
    to_from: Float[Tensor, "*batch 4 4"], points: Float[Tensor, "*batch point 3"]
) -> Float[Tensor, "*batch point 3"]:
    """Points in the frame that the rigid or similarity transform leads to."""
    return points @ to_from[..., :3, :3].mT + to_from[..., None, :3, 3]


def rigid(
    rotation: Float[Tensor, "*batch 3 3"], translation: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch 4 4"]:
    """The 4x4 transform x -> rotation x + translation."""
    top = torch.cat([rotation, translation[..., None]], dim=-1)
    bottom = torch.zeros_like(top[..., :1, :])
    bottom = torch.cat([bottom[..., :3], torch.ones_like(bottom[..., :1])], dim=-1)
    return torch.cat([top, bottom], dim=-2)


def invert_rigid(to_from: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 4 4"]:
    """The inverse of rigid transforms, exact for orthonormal rotations."""
    rotation = to_from[..., :3, :3].mT
    translation = -(rotation @ to_from[..., :3, 3:]).squeeze(-1)
    return rigid(rotation, translation)


def relative_to_first(
    cam_from_world: Float[Tensor, "*batch view 4 4"],
) -> Float[Tensor, "*batch view 4 4"]:
    """The same cameras with the first one as the world."""
    return cam_from_world @ invert_rigid(cam_from_world[..., :1, :, :])


def resize_intrinsics(
    intrinsics: Float[Tensor, "*batch 3 3"],
    *,
    scale_x: float,
    scale_y: float,
    offset_x: float = 0.0,
    offset_y: float = 0.0,
) -> Float[Tensor, "*batch 3 3"]:
    """Intrinsics after an image was scaled and then shifted by offset pixels (a pad is positive).

    With pixel centres at half integers, scaling by s maps x to s x exactly, so the principal
    point scales like the focal length.
    """
    change = torch.tensor(
        [[scale_x, 0.0, offset_x], [0.0, scale_y, offset_y], [0.0, 0.0, 1.0]],
        dtype=intrinsics.dtype,
        device=intrinsics.device,
    )
    return change @ intrinsics


def intrinsics_from_field_of_view(
    field_of_view_x_rad: Float[Tensor, "*batch"], height: int, width: int
) -> Float[Tensor, "*batch 3 3"]:
    """Square pixels, principal point in the middle, the given horizontal field of view."""
    focal = 0.5 * width / torch.tan(0.5 * field_of_view_x_rad)
    result = torch.zeros(*focal.shape, 3, 3, dtype=focal.dtype, device=focal.device)
    result[..., 0, 0] = focal
    result[..., 1, 1] = focal
    result[..., 0, 2] = 0.5 * width
    result[..., 1, 2] = 0.5 * height
    result[..., 2, 2] = 1.0
    return result
