"""A backbone small enough for tests: one plane in front of every camera, patchified features."""

from dataclasses import dataclass

import torch
from torch import nn

from instok3d.backbones import (
    BackboneConfig,
    BackboneKind,
    GeometryBackbone,
    Prediction,
    settle_geometry,
)
from instok3d.geometry.cameras import intrinsics_from_field_of_view
from instok3d.types import Geometry, Views


@dataclass(frozen=True)
class PlaneConfig(BackboneConfig):
    patch_size: int = 8
    channels: int = 16


class PlaneBackbone(GeometryBackbone):
    """Depth 2 to 3, a smooth function of the pixel; cameras 0.1 apart along x."""

    def __init__(self, config: PlaneConfig):
        super().__init__()
        self.config = config
        self.patch_size = config.patch_size
        self.feature_channels = config.channels
        self.stem = nn.Conv2d(3, config.channels, config.patch_size, config.patch_size)

    def forward(self, views: Views) -> Geometry:
        batch, count, _, height, width = views.images.shape
        features = self.stem(views.images.flatten(0, 1)).flatten(2).mT
        y, x = torch.meshgrid(
            torch.linspace(0, 1, height), torch.linspace(0, 1, width), indexing="ij"
        )
        depths = (2 + 0.7 * y + 0.3 * x * x).expand(batch, count, -1, -1)
        cam_from_world = torch.eye(4).repeat(batch, count, 1, 1)
        cam_from_world[..., 0, 3] = -0.1 * torch.arange(count)
        angle = torch.full((batch, count), 1.0)
        prediction = Prediction(
            features=features.unflatten(0, (batch, count)),
            depths=depths,
            confidences=torch.ones_like(depths),
            cam_from_world=cam_from_world,
            intrinsics=intrinsics_from_field_of_view(angle, height, width),
        )
        return settle_geometry(views, prediction)


PLANE = BackboneKind(PlaneBackbone, PlaneConfig)
"""All that a backbone must say of itself; its memory is not known."""
