"""The interface of geometry backbones, and how given cameras and depths enter their answer."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from instok3d.geometry.cameras import (
    invert_rigid,
    relative_to_first,
    transform_points,
    unproject,
)
from instok3d.types import Cameras, Geometry, Views


@dataclass(frozen=True)
class BackboneConfig:
    """Base of the frozen dataclasses that hold the sizes of a backbone.

    Their fields are what JSON can hold (numbers, texts, tuples of these): files of models and runs
    keep them.
    """

    @property
    def image_side(self) -> int:
        """Side of the pictures that it is made for, pixels."""
        return 128


class GeometryBackbone(nn.Module, ABC):
    """Photos in; features, depths, pointmaps, confidences and cameras out.

    A third party plugs another network in by writing this one class. The network sees all views
    of a scene together (1 to 16 of them, one set of weights) and gives, with B scenes of V views
    and images of height x width pixels:

    - `features` [B, V, patches, feature_channels]: one vector for each square of
      patch_size x patch_size pixels, row-major, that has seen the other views too. No particular
      scale: the tokenizer normalises them.
    - `depths`, `confidences`, `cameras`, `pointmaps`: float32, see `types.Geometry`. The first
      view's camera is the world.

    What is given must be kept. `views.intrinsics`, `views.cam_from_world` and `views.depths` come
    from the user (an RGB-D camera, a phone, a robot): cameras for all views or for none, depth
    for each pixel or 0 where it is unknown. Where they are there, the returned geometry holds
    exactly them, and the units of the result are theirs. `settle_geometry` does that from a bare
    prediction, so a `forward` mostly ends with

        return settle_geometry(views, prediction)

    A network may also take what is given as an input, which makes its prediction better.

    Height and width are multiples of patch_size; the tokenizer checks that. Geometry maths
    (unprojection, solving for cameras) belongs in float32, outside autocast. To be saved with the
    model, the backbone carries its frozen config dataclass as `self.config` and is registered
    (`backbones.registry.register_backbone`).
    """

    patch_size: int
    """Side of a patch, pixels."""
    feature_channels: int
    """Width of `Geometry.features`."""
    config: Any
    """The frozen dataclass that the backbone was made from."""

    @abstractmethod
    def forward(self, views: Views) -> Geometry:
        """Geometry of each scene of the batch, which holds what the views give."""


@dataclass(frozen=True)
class Prediction:
    """What a network says of the views on its own, in units of its own."""

    features: Float[Tensor, "batch view patch channel"]
    """F."""
    depths: Float[Tensor, "batch view height width"]
    """z-depth in each view's own camera, > 0."""
    confidences: Float[Tensor, "batch view height width"]
    """> 0."""
    cam_from_world: Float[Tensor, "batch view 4 4"]
    """In any world frame, in the units of the depths."""
    intrinsics: Float[Tensor, "batch view 3 3"]
    """Pixels; used where the views do not give them."""


def settle_geometry(views: Views, prediction: Prediction) -> Geometry:
    """Geometry in which everything that the views give stands in for the prediction.

    One length ties the network's units to those of the user: the median ratio of given to
    predicted depths, or without depths the ratio of the lengths of the camera paths. Predicted
    depths and camera positions are multiplied by it. With nothing given it is 1.

    Differentiable in the prediction, except for that length.
    """
    with torch.autocast(views.images.device.type, enabled=False):
        scale = _given_per_predicted(views, prediction)
        depths = prediction.depths.float() * scale[:, None, None, None]
        if views.depths is not None:
            depths = torch.where(views.depths > 0, views.depths.float(), depths)
        if views.cam_from_world is None:
            cam_from_world = relative_to_first(prediction.cam_from_world.float())
            translation = cam_from_world[..., :3, 3:] * scale[:, None, None, None]
            top = torch.cat([cam_from_world[..., :3, :3], translation], dim=-1)
            cam_from_world = torch.cat([top, cam_from_world[..., 3:, :]], dim=-2)
        else:
            cam_from_world = relative_to_first(views.cam_from_world.float())
        given = views.intrinsics
        intrinsics = prediction.intrinsics.float() if given is None else given.float()
        points = unproject(depths, intrinsics)
        pointmaps = transform_points(invert_rigid(cam_from_world), points.flatten(2, 3))
        return Geometry(
            features=prediction.features,
            depths=depths,
            pointmaps=pointmaps.view_as(points),
            confidences=prediction.confidences.float(),
            cameras=Cameras(cam_from_world, intrinsics),
        )


@torch.no_grad()
def _given_per_predicted(views: Views, prediction: Prediction) -> Float[Tensor, " batch"]:
    batch = views.images.shape[0]
    scale = torch.ones(batch, device=views.images.device)
    if views.cam_from_world is not None:
        given = _path_length(views.cam_from_world.float())
        predicted = _path_length(prediction.cam_from_world.float())
        known = (given > 1e-6) & (predicted > 1e-6)
        scale = torch.where(known, given / predicted.clamp_min(1e-6), scale)
    if views.depths is not None:
        for scene in range(batch):
            known = views.depths[scene] > 0
            if known.any():
                ratios = views.depths[scene][known] / prediction.depths[scene][known]
                scale[scene] = ratios.float().median()
    return scale


def _path_length(cam_from_world: Float[Tensor, "batch view 4 4"]) -> Float[Tensor, " batch"]:
    centers = invert_rigid(cam_from_world)[..., :3, 3]
    return (centers - centers[:, :1]).norm(dim=-1).sum(dim=-1)
