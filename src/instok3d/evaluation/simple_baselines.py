"""Predictions that need no model of objects, measured by the same evaluator."""

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy import ndimage
from scipy.spatial.distance import cdist
from torch import Tensor

from instok3d.data.sample import Sample
from instok3d.evaluation.instance_ap import PredictedMasks
from instok3d.geometry.cameras import invert_rigid, project, transform_points
from instok3d.types import Cameras, Geometry

NUM_COLOR_CLUSTERS = 6
"""With POSITION_WEIGHT, what gave the highest AP50 on 16 training rooms."""
POSITION_WEIGHT = 20.0
"""Lab units for the length of an image side: how much place counts beside colour."""

DEPTH_TOLERANCE = 0.05
"""Relative depth behind the nearest point of a pixel that still counts as its surface."""


def nearest_contexts(sample: Sample) -> Int[Tensor, " target"]:
    """For each target, the context view whose true camera stands nearest (sample of one)."""
    assert sample.context.cam_from_world is not None
    assert sample.target.cam_from_world is not None
    context = invert_rigid(sample.context.cam_from_world[0])[:, :3, 3]
    target = invert_rigid(sample.target.cam_from_world[0])[:, :3, 3]
    return torch.cdist(target, context).argmin(dim=1)


def warped_photos(
    sample: Sample, geometry: Geometry, cameras: Cameras
) -> Float[Tensor, "target 3 height width"]:
    """The nearest context photo, carried into each target view by the depth of the geometry.

    Holes keep the photo as it was.

    Args:
        sample: A batch of one.
        geometry: Of its context views.
        cameras: The targets' cameras in the world of the geometry; no batch axis.
    """
    warped = []
    for number, context in enumerate(nearest_contexts(sample).tolist()):
        photo = sample.context.images[0, context]
        points = geometry.pointmaps[0, context].reshape(-1, 3)
        in_camera = transform_points(cameras.cam_from_world[number], points)
        warped.append(_splat(photo, in_camera, cameras.intrinsics[number]))
    return torch.stack(warped)


def _splat(
    photo: Float[Tensor, "3 height width"],
    points: Float[Tensor, "point 3"],
    intrinsics: Float[Tensor, "3 3"],
) -> Float[Tensor, "3 height width"]:
    """The photo's pixels drawn where their points fall, bilinearly, the nearest surface only."""
    height, width = photo.shape[-2:]
    in_front = points[:, 2] > 1e-3
    depths = points[in_front, 2]
    colors = photo.flatten(1)[:, in_front]
    pixels = project(points[in_front], intrinsics)
    corner = (pixels - 0.5).floor()

    def places(landing: Tensor) -> tuple[Tensor, Tensor]:
        column, row = landing.long().unbind(1)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        return (row * width + column)[inside], inside

    landing, inside = places(pixels.floor())
    nearest = torch.full((height * width,), torch.inf)
    nearest.scatter_reduce_(0, landing, depths[inside], "amin")
    total = torch.zeros(4, height * width)
    for offset in ((0, 0), (1, 0), (0, 1), (1, 1)):
        at = corner + torch.tensor(offset)
        weight = (1 - (pixels - 0.5 - at).abs()).prod(dim=1)
        landing, inside = places(at)
        seen = depths[inside] <= (1 + DEPTH_TOLERANCE) * nearest[landing]
        weight = weight[inside] * seen
        total.index_add_(1, landing, torch.cat([colors[:, inside] * weight, weight[None]]))
    filled = total[3] > 0.1
    image = photo.flatten(1).clone()
    image[:, filled] = (total[:3] / total[3].clamp_min(0.1))[:, filled]
    return image.view(3, height, width)


def color_masks(photo: Float[Tensor, "3 height width"]) -> PredictedMasks:
    """Connected regions of alike colour in a photo; confidence = share of the image.

    k-means with a fixed k on CIE Lab and position, seeded; each connected part of a cluster is
    one mask. Applied to the true target photo, it sees what no method that renders may see.
    """
    _, height, width = photo.shape
    y, x = np.mgrid[0:height, 0:width] * (POSITION_WEIGHT / max(height, width))
    lab = _lab_from_srgb(photo.detach().cpu().double().numpy())
    features = np.stack([*lab, y, x]).reshape(5, -1).T
    clusters = _k_means(features, NUM_COLOR_CLUSTERS).reshape(height, width)
    ids = np.full((height, width), -1)
    count = 0
    for cluster in range(NUM_COLOR_CLUSTERS):
        parts = np.zeros((height, width), dtype=np.int64)
        ndimage.label(clusters == cluster, output=parts)
        ids[parts > 0] = parts[parts > 0] - 1 + count
        count += int(parts.max())
    return PredictedMasks(ids, np.bincount(ids.ravel(), minlength=count) / ids.size)


def _k_means(
    points: Float[np.ndarray, "point channel"], count: int, *, rounds: int = 30
) -> Int[np.ndarray, " point"]:
    """Cluster of each point by Lloyd's algorithm from seeded random points; some may be empty."""
    start = np.random.default_rng(0).choice(len(points), min(count, len(points)), replace=False)
    centers = points[start]
    nearest = cdist(points, centers).argmin(axis=1)
    for _ in range(rounds):
        members = nearest[:, None] == np.arange(len(centers))
        size = members.sum(axis=0)[:, None]
        centers = np.where(size > 0, members.T @ points / np.maximum(size, 1), centers)
        nearest = cdist(points, centers).argmin(axis=1)
    return nearest


def _lab_from_srgb(image: Float[np.ndarray, "3 height width"]) -> Float[np.ndarray, "3 h w"]:
    """CIE Lab (D65) of sRGB in [0, 1]."""
    linear = np.where(image <= 0.04045, image / 12.92, ((image + 0.055) / 1.055) ** 2.4)
    xyz_from_rgb = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    xyz = np.tensordot(xyz_from_rgb / xyz_from_rgb.sum(axis=1, keepdims=True), linear, axes=1)
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.stack([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])
