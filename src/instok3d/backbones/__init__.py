"""Geometry from photos: the interface, three networks behind it, and how to add another one."""

from instok3d.backbones.base import (
    BackboneConfig,
    GeometryBackbone,
    Prediction,
    settle_geometry,
)
from instok3d.backbones.cost import Activations, Outline, Work
from instok3d.backbones.registry import BackboneKind, build_backbone, register_backbone

__all__ = [
    "Activations",
    "BackboneConfig",
    "BackboneKind",
    "GeometryBackbone",
    "Outline",
    "Prediction",
    "Work",
    "build_backbone",
    "register_backbone",
    "settle_geometry",
]
