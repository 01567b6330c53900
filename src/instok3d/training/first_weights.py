"""Weights that a stage begins with or is judged by: of backbones, and of LPIPS."""

from collections.abc import Mapping
from pathlib import Path

from torch import Tensor

from instok3d.backbones import depth_anything3
from instok3d.backbones.base import GeometryBackbone
from instok3d.backbones.depth_anything3 import DepthAnything3Backbone, DepthAnything3Config
from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.backbones.vggt import VGGTBackbone, VGGTConfig
from instok3d.backbones.vggt import weights as vggt_weights
from instok3d.objectives.lpips import Lpips, load_lpips
from instok3d.training.cache.features import of_backbone
from instok3d.weights import weights_path

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


def lpips_network(weight: float, file: Path | None, name: str) -> Lpips | None:
    """The network of the perceptual loss; None where its weight is 0.

    Args:
        weight: Of the perceptual term in the loss.
        file: Its weights as safetensors; None takes those of the catalogue.
        name: In the catalogue (`instok3d models list`).

    Raises:
        MissingWeightsError: They are not on this machine; says how to get them.
        ValueError: The file holds something else.
    """
    if weight <= 0:
        return None
    return load_lpips(weights_path(name) if file is None else file)
