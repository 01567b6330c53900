"""Weights of a backbone that a stage begins with."""

from collections.abc import Mapping

from torch import Tensor

from instok3d.backbones import depth_anything3
from instok3d.backbones.base import GeometryBackbone
from instok3d.backbones.depth_anything3 import DepthAnything3Backbone, DepthAnything3Config
from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.backbones.vggt import VGGTBackbone, VGGTConfig
from instok3d.backbones.vggt import weights as vggt_weights
from instok3d.training.cache.features import of_backbone

BackboneConfig = NanoConfig | VGGTConfig | DepthAnything3Config
"""Sizes of a backbone that a stage can be built on (`backbones.registry`)."""


def load_backbone(backbone: GeometryBackbone, weights: Mapping[str, Tensor]) -> None:
    """Fill a backbone from a run of any stage, from its own weights, or from published ones.

    VGGT's published weights have patches of 14 pixels and no layer for intrinsics: patches are
    resized to the backbone's, and the layer starts anew (`vggt.weights.from_published`).

    Raises:
        RuntimeError: They do not fit.
    """
    inner = of_backbone(weights)
    if isinstance(backbone, DepthAnything3Backbone) and depth_anything3.is_published(inner):
        backbone.net.load_state_dict(depth_anything3.from_published(inner))
    elif isinstance(backbone, VGGTBackbone) and vggt_weights.is_published(inner):
        backbone.vggt.load_state_dict(vggt_weights.from_published(inner, backbone.config))
    else:
        backbone.load_state_dict(inner)
