"""Instances in space: the Gaussians of a scene against points of the true instances.

As ScanNet asks for instances of its meshes, in classless form: what is compared is which points of
the surfaces belong together, over all views at once. A point belongs to the group whose Gaussians
are densest there.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from instok3d.data.sample import Sample
from instok3d.evaluation.instance_ap import (
    ApSettings,
    ImageMatches,
    match_image,
    predicted_masks,
)
from instok3d.evaluation.methods import FittedScene
from instok3d.geometry.camera_alignment import TargetCameras, points_in_prediction
from instok3d.geometry.cameras import invert_rigid, transform_points, unproject
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.types import Cameras, Gaussians

POINTS = 4096
"""Of a sample, drawn evenly from the pixels of its context views."""
NEIGHBORS = 64
"""Gaussians whose centres are nearest to a point, which alone count there."""
DENSITY_MIN = 0.05
"""Sum of opacity times the falloff from the centre, below which a point belongs to no group."""
SETTINGS = ApSettings(min_instance_area=10, min_predicted_area=5)
"""In points."""


@dataclass(frozen=True)
class TruePoints:
    """Points of surfaces that the context views see."""

    positions: Float[Tensor, "point 3"]
    """In the world of the true cameras."""
    instances: Int[Tensor, " point"]
    """0 = no instance, -1 = ignore."""


def true_points(sample: Sample) -> TruePoints | None:
    """Points of a sample of one, the same in every run; None without true depth or instances."""
    context, instances = sample.context, sample.context_instances[0]
    cameras = _cameras(sample)
    assert context.depths is not None
    depths = context.depths[0]
    known = (depths > 0) & (instances >= 0)
    if not (instances[known] > 0).any():
        return None
    points = unproject(depths, cameras.intrinsics).flatten(1, 2)
    world = transform_points(invert_rigid(cameras.cam_from_world), points).view(*depths.shape, 3)
    random = torch.Generator().manual_seed(0)
    chosen = torch.randperm(int(known.sum()), generator=random)[:POINTS].sort().values
    return TruePoints(world[known][chosen], instances[known][chosen])


def match_points(
    scene: FittedScene, sample: Sample, target_cameras: TargetCameras
) -> ImageMatches | None:
    """The groups of a scene, as sets of points, against the true instances.

    Args:
        scene: That was fitted to the context views of the sample.
        sample: A batch of one.
        target_cameras: Whether the world of the scene is the true one ('true') or the points are
            brought into it by the context cameras ('aligned').

    Returns:
        None where the scene knows no instances, or the truth is not known.
    """
    points = true_points(sample)
    if scene.assignment is None or points is None:
        return None
    positions = points.positions
    if target_cameras == "aligned":
        positions = points_in_prediction(
            positions, predicted_context=scene.cameras, true_context=_cameras(sample)
        )
    densities = group_densities(scene.gaussians, scene.assignment, positions)
    total = densities.sum(dim=1)
    shares = densities[:, :-1] / total.clamp_min(1e-8)[:, None]
    masks = predicted_masks(shares.T[:, None], total[None], alpha_min=DENSITY_MIN)
    return match_image(points.instances[None].cpu().numpy(), masks, SETTINGS)


def group_densities(
    gaussians: Gaussians,
    assignment: Float[Tensor, "anchor column"],
    points: Float[Tensor, "point 3"],
) -> Float[Tensor, "point column"]:
    """Sum over the nearest Gaussians of opacity x exp(-d^2 / 2) x probability of each group.

    d is the distance in standard deviations.

    Args:
        gaussians: Of one scene.
        assignment: Of their anchors, the void's last.
        points: In the world of the Gaussians.
    """
    count = min(NEIGHBORS, len(gaussians.means))
    if not count:
        return points.new_zeros(len(points), assignment.shape[1])
    found = KDTree(gaussians.means.cpu().numpy()).query(points.cpu().numpy(), k=count)[1]
    near = torch.from_numpy(found.reshape(len(points), count)).to(points.device)
    apart = points[:, None] - gaussians.means[near]
    along = (quat_to_matrix(gaussians.quats)[near].mT @ apart[..., None])[..., 0]
    squared = (along / gaussians.scales[near]).square().sum(dim=2)
    weights = gaussians.opacities[near] * torch.exp(-0.5 * squared)
    densities = points.new_zeros(len(points), assignment.shape[1])
    for rank in range(count):
        own = assignment[gaussians.anchor_index[near[:, rank]]]
        densities += weights[:, rank, None] * own
    return densities


def _cameras(sample: Sample) -> Cameras:
    context = sample.context
    assert context.cam_from_world is not None
    assert context.intrinsics is not None
    return Cameras(context.cam_from_world[0], context.intrinsics[0])
