"""Weights of a backbone that a stage begins with."""

from collections.abc import Mapping

from torch import Tensor

from instok3d.backbones.base import GeometryBackbone
from instok3d.backbones.registry import kind_of
from instok3d.training.cache.features import of_backbone


def load_backbone(backbone: GeometryBackbone, weights: Mapping[str, Tensor]) -> None:
    """Fill a backbone from a run of any stage, from its own weights, or from published ones.

    Published weights may be changed on the way, as the backbone's kind says: VGGT's patches are
    resized, and its layer for intrinsics starts anew.

    Raises:
        RuntimeError: They do not fit.
    """
    inner = of_backbone(weights)
    load_published = kind_of(backbone.config).load_published
    if load_published is None or not load_published(backbone, inner):
        backbone.load_state_dict(inner)
