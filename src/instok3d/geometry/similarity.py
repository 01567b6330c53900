"""Fitting rigid and similarity transforms, and aligning predicted cameras to true ones."""

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid


def weighted_procrustes(
    source: Float[Tensor, "*batch point 3"],
    target: Float[Tensor, "*batch point 3"],
    weights: Float[Tensor, "*batch point"],
) -> tuple[Float[Tensor, "*batch 3 3"], Float[Tensor, "*batch 3"]]:
    """Rotation R and translation t that bring R source + t nearest to target (Kabsch).

    Runs outside autocast. Differentiable while the singular values are distinct; a small
    multiple of the identity is added so that degenerate sets give finite gradients too.

    Args:
        source: Points in any frame.
        target: The same points in the other frame.
        weights: Not negative; they are normalised to sum 1 here.
    """
    weights = (weights / weights.sum(-1, keepdim=True).clamp_min(1e-12))[..., None]
    source_center = (weights * source).sum(-2, keepdim=True)
    target_center = (weights * target).sum(-2, keepdim=True)
    covariance = ((target - target_center) * weights).mT @ (source - source_center)
    covariance = covariance + 1e-6 * torch.eye(3, dtype=source.dtype, device=source.device)
    u, _, vh = torch.linalg.svd(covariance)
    handedness = torch.det((u @ vh).detach())
    signs = torch.stack(
        [torch.ones_like(handedness), torch.ones_like(handedness), handedness], dim=-1
    )
    rotation = (u * signs[..., None, :]) @ vh
    translation = target_center.squeeze(-2) - (rotation @ source_center.mT).squeeze(-1)
    return rotation, translation


def depth_scale(
    predicted: Float[Tensor, "*batch height width"], true: Float[Tensor, "*batch height width"]
) -> Float[Tensor, ""]:
    """The one factor that brings predicted depths to true ones: the median of their ratios.

    Pixels whose true depth is 0 (unknown) are left out.

    Raises:
        ValueError: No pixel has a known true depth.
    """
    known = true > 0
    if not known.any():
        raise ValueError("depth_scale needs at least one pixel with a true depth > 0")
    return (true[known] / predicted[known].clamp_min(1e-9)).median()


def align_cameras(
    predicted_cam_from_world: Float[Tensor, "view 4 4"],
    true_cam_from_world: Float[Tensor, "view 4 4"],
    *,
    scale: float | Tensor,
) -> Float[Tensor, "4 4"]:
    """The transform predicted_from_true between the two worlds, with the errors spread evenly.

    A camera of the true world is seen in the predicted world as
    `cam_from_predicted = cam_from_true @ inverse(predicted_from_true)` up to the scale, which
    this function leaves in the translation: true lengths are divided by `scale` first.

    The rotation is the mean over views (chordal, projected to SO(3)), the translation brings the
    mean of the camera centres together, so that no single view takes the whole error.

    Args:
        predicted_cam_from_world: Cameras that were predicted.
        true_cam_from_world: The same cameras, given.
        scale: True length of one predicted unit.
    """
    true_cam_from_world = true_cam_from_world.clone()
    true_cam_from_world[:, :3, 3] = true_cam_from_world[:, :3, 3] / scale
    predicted_world_from_cam = invert_rigid(predicted_cam_from_world)
    true_world_from_cam = invert_rigid(true_cam_from_world)
    each = predicted_world_from_cam[:, :3, :3] @ true_world_from_cam[:, :3, :3].mT
    u, _, vh = torch.linalg.svd(each.sum(0))
    signs = torch.ones(3, dtype=u.dtype, device=u.device)
    signs[2] = torch.det(u @ vh)
    rotation = (u * signs) @ vh
    predicted_center = predicted_world_from_cam[:, :3, 3].mean(0)
    true_center = true_world_from_cam[:, :3, 3].mean(0)
    result = torch.eye(4, dtype=u.dtype, device=u.device)
    result[:3, :3] = rotation
    result[:3, 3] = predicted_center - rotation @ true_center
    return result
