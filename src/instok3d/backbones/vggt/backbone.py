"""VGGT as a geometry backbone."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from instok3d.backbones.base import GeometryBackbone, Prediction, settle_geometry
from instok3d.backbones.vggt.camera_head import decode_cameras
from instok3d.backbones.vggt.config import VGGTConfig
from instok3d.backbones.vggt.network import VGGT
from instok3d.geometry.cameras import (
    pixel_rays,
    relative_to_first,
    rigid,
    transform_points,
)
from instok3d.types import Cameras, Geometry, Views

SMALLEST_DEPTH = 1e-4
"""Points on or behind a camera's plane count as this far in front of it."""


class VGGTBackbone(GeometryBackbone):
    """Features, pointmaps and cameras of VGGT.

    Features are the last pair's patch tokens, 2 x embed_dim channels. With
    `geometry_from="points"` (the paper's) the pointmaps are the point head's answer as it is. Its
    units need not be the camera head's: fine-tuning with rendered pictures teaches it those of
    the true cameras, and teaches the camera head nothing. So the rotations and the fields of view
    come from the camera head, and the camera centres from the points themselves. With
    `geometry_from="depths"` everything comes from the depth head and the camera head, which is
    what its authors recommend for the model as it was published.

    Given cameras or depths stand in for the prediction; the points are then unprojected. Given
    the network is conditioned on the intrinsics if it has the intrinsics token.
    """

    def __init__(self, config: VGGTConfig) -> None:
        super().__init__()
        self.config = config
        self.patch_size = config.patch_size
        self.feature_channels = 2 * config.embed_dim
        self.vggt = VGGT(config)

    def forward(self, views: Views) -> Geometry:
        """Geometry of the views, which holds what they give.

        May run under autocast: the heads and all that follows stay in float32. Differentiable,
        but for the cameras where they are solved from the points.

        Raises:
            ValueError: The image size is no multiple of the patch size.
        """
        network, last = self.vggt, self.config.depth - 1
        size = views.images.shape[-2:]
        layers = {*self.config.dpt_layers, last}
        tokens = network.aggregator(views.images, views.intrinsics, layers=layers)
        features = network.patch_tokens(tokens[last]).float()
        with torch.autocast(views.images.device.type, enabled=False):
            cameras = decode_cameras(network.poses(tokens), *size)
            if views.intrinsics is not None:
                cameras = Cameras(cameras.cam_from_world, views.intrinsics.float())
            if self.config.geometry_from == "depths":
                depths, confidences = network.depths(tokens, size)
                return settle_geometry(
                    views, _prediction(features, depths[..., 0], confidences, cameras)
                )
            points, confidences = network.points(tokens, size)
            seen = see_points(points, confidences, cameras)
            if views.depths is not None or views.cam_from_world is not None:
                return settle_geometry(
                    views, _prediction(features, seen.depths, confidences, seen.cameras)
                )
            return Geometry(
                features=features,
                depths=seen.depths,
                pointmaps=points,
                confidences=confidences,
                cameras=seen.cameras,
            )

    def adapted_parameters(self) -> list[nn.Parameter]:
        """The parameters that get a gradient from features and pointmaps: what a stage can train.

        Without the heads that are not asked, without the camera head where it only says where the
        cameras are, and without the encoder's mask token and the camera head's first pose.
        """
        heads = {
            "points": [self.vggt.point_head],
            "depths": [self.vggt.depth_head, self.vggt.camera_head],
        }[self.config.geometry_from]
        parts = [self.vggt.aggregator, *heads]
        unused = {
            id(self.vggt.aggregator.patch_embed.mask_token),
            id(self.vggt.camera_head.empty_pose_tokens),
        }
        return [each for part in parts for each in part.parameters() if id(each) not in unused]


@dataclass(frozen=True)
class SeenPoints:
    """Cameras that see a pointmap, and how deep its points lie in them."""

    depths: Float[Tensor, "batch view height width"]
    """z-depth in each view's own camera, at least SMALLEST_DEPTH."""
    cameras: Cameras
    """The first camera is the world."""


def see_points(
    points: Float[Tensor, "batch view height width 3"],
    confidences: Float[Tensor, "batch view height width"],
    cameras: Cameras,
) -> SeenPoints:
    """Cameras in the units of the points, and the points' depths in them.

    Rotations relative to the first camera and intrinsics are kept. Each translation t is solved
    for: the points R p + t are to lie on the rays of their pixels, least squares of the sine of
    the angle between, weighted by confidence. Not differentiable in the cameras.

    Args:
        points: In the first camera's frame, one for each pixel.
        confidences: > 0.
        cameras: In units of any length.
    """
    with torch.no_grad():
        rotation = relative_to_first(cameras.cam_from_world)[..., :3, :3]
        turned = points @ rotation.mT[:, :, None]
        rays = pixel_rays(cameras.intrinsics, *points.shape[2:4])
        rays = functional.normalize(rays, dim=-1).flatten(2, 3)
        translation = _onto_rays(turned.flatten(2, 3), rays, confidences.flatten(2))
        translation[:, 0] = 0
        cam_from_world = rigid(rotation, translation)
    in_camera = transform_points(cam_from_world, points.flatten(2, 3)).view_as(points)
    depths = in_camera[..., 2].clamp_min(SMALLEST_DEPTH)
    return SeenPoints(depths, Cameras(cam_from_world, cameras.intrinsics))


def _onto_rays(
    points: Float[Tensor, "batch view point 3"],
    rays: Float[Tensor, "batch view point 3"],
    confidences: Float[Tensor, "batch view point"],
) -> Float[Tensor, "batch view 3"]:
    """The shift t with the least sum of w |(I - r r^T)(p + t)|^2, w = confidence / |p|^2."""
    weights = confidences / points.square().sum(-1).clamp_min(SMALLEST_DEPTH**2)
    weights = torch.where(weights.isfinite(), weights, 0)
    weights = (weights / weights.sum(-1, keepdim=True))[..., None]
    points = torch.where(points.isfinite(), points, 0)
    beside = points - rays * (rays * points).sum(-1, keepdim=True)
    matrix = torch.eye(3, device=rays.device) - (weights * rays).mT @ rays
    return torch.linalg.solve(matrix, -(weights * beside).sum(-2))


def _prediction(
    features: Tensor, depths: Tensor, confidences: Tensor, cameras: Cameras
) -> Prediction:
    return Prediction(
        features=features,
        depths=depths,
        confidences=confidences,
        cam_from_world=cameras.cam_from_world,
        intrinsics=cameras.intrinsics,
    )
