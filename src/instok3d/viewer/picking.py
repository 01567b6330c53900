"""Which object a pixel shows: the Gaussians composited there, as the picture is."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.moving import Point
from instok3d.render.reference import blending_weights, project_gaussians
from instok3d.render.settings import RasterSettings
from instok3d.scene.edits.ownership import drawn_rows, row_ids
from instok3d.scene.scene import Scene


@dataclass(frozen=True)
class Picked:
    """What a pixel shows."""

    object: int
    """Id of the object with the largest share of the pixel; 0 where the rest or nothing has it."""
    point: Point | None
    """Where it lies along the ray, in the mean of its Gaussians; None where there is nothing."""


@torch.no_grad()
def pick(
    scene: Scene,
    cam_from_world: Float[Tensor, "4 4"],
    intrinsics: Float[Tensor, "3 3"],
    height: int,
    width: int,
    pixel: tuple[float, float],
) -> Picked:
    """The object with the largest share of a pixel.

    Args:
        scene: Hidden objects are not picked.
        cam_from_world: Of the camera.
        intrinsics: For pictures of this size.
        height: Of the picture, pixels.
        width: Likewise.
        pixel: x, y; the centre of the top-left pixel is (0.5, 0.5).
    """
    settings = RasterSettings()
    gaussians, (near, far) = scene.gaussians, scene.near_far
    # 1. What can reach the pixel: within 4 standard deviations of its ray, or 4 pixels.
    in_cam = gaussians.means @ cam_from_world[:3, :3].mT + cam_from_world[:3, 3]
    focal, center = intrinsics.diagonal()[:2], intrinsics[:2, 2]
    at = torch.tensor(pixel, dtype=in_cam.dtype)
    z = in_cam[:, 2].clamp_min(near)
    reach = gaussians.scales.amax(1) * (1 + (in_cam[:, :2] / z[:, None]).square().sum(1)).sqrt()
    away = in_cam[:, :2] / z[:, None] * focal + center - at
    close = away.norm(dim=1) <= 4 * (focal.max() * reach / z + 1)
    rows = (close & drawn_rows(scene) & (gaussians.opacities >= settings.alpha_min)).nonzero()[:, 0]
    # 2. The same projection as that of the picture, front to back.
    seen = gaussians.rows(rows)
    projected = project_gaussians(
        seen.means, seen.quats, seen.scales, cam_from_world, intrinsics, height, width,
        near=near, far=far, eps2d=settings.eps2d,
    )  # fmt: skip
    inside = projected.inside.nonzero()[:, 0]
    order = inside[projected.depths[inside].argsort(stable=True)]
    in_order = projected.rows(order)
    weights = blending_weights(in_order, seen.opacities[order], at[None], settings)[0]
    # 3. Shares of the objects; the rest and what shines through count for none.
    ids = row_ids(scene)[rows[order]]
    shares = torch.zeros(len(scene.tokens.groups) + 1).index_add(0, ids, weights)
    covered = float(weights.sum())
    shares[0] += 1 - covered
    found = int(shares.argmax())
    own = weights * (ids == found)
    if found == 0 and 1 - covered > float(own.sum()):
        return Picked(0, None)
    # 4. The point of the ray at the mean depth of the winner.
    depth = (own * in_order.depths).sum() / own.sum()
    ray = torch.cat([(at - center) / focal, torch.ones(1)]) * depth
    x, y, z = (cam_from_world[:3, :3].mT @ (ray - cam_from_world[:3, 3])).tolist()
    return Picked(found, (x, y, z))
