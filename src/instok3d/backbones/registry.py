"""The geometry backbones that a file, a stage or a command may name, imported when one does."""

from collections.abc import Callable
from typing import Any, NamedTuple

from instok3d.backbones.base import GeometryBackbone


class BackboneKind(NamedTuple):
    """A backbone class with the dataclass of its sizes."""

    backbone: Callable[[Any], GeometryBackbone]
    config: type


def _nano() -> BackboneKind:
    from instok3d.backbones.nano.backbone import NanoBackbone, NanoConfig

    return BackboneKind(NanoBackbone, NanoConfig)


def _vggt() -> BackboneKind:
    from instok3d.backbones.vggt import VGGTBackbone, VGGTConfig

    return BackboneKind(VGGTBackbone, VGGTConfig)


def _depth_anything_3() -> BackboneKind:
    from instok3d.backbones.depth_anything3 import (
        DepthAnything3Backbone,
        DepthAnything3Config,
    )

    return BackboneKind(DepthAnything3Backbone, DepthAnything3Config)


BACKBONES: dict[str, Callable[[], BackboneKind]] = {
    "nano": _nano,
    "vggt": _vggt,
    "depth-anything-3": _depth_anything_3,
}
"""A new backbone is one more line here: its name and what imports it."""


def build_backbone(config: Any) -> GeometryBackbone:
    """A new backbone of these sizes, with random weights.

    Args:
        config: The dataclass of one of the registered kinds, e.g. NanoConfig or VGGTConfig.

    Raises:
        ValueError: No registered backbone is made from such a dataclass.
    """
    for load in BACKBONES.values():
        kind = load()
        if type(config) is kind.config:
            return kind.backbone(config)
    raise ValueError(
        f"no backbone is made from a {type(config).__name__}; wanted the config of one of "
        f"{sorted(BACKBONES)}"
    )


def name_of(backbone: GeometryBackbone) -> str:
    """The name under which this backbone's class is registered.

    Raises:
        ValueError: Its class is not registered.
    """
    for name, load in BACKBONES.items():
        if type(backbone) is load().backbone:
            return name
    raise ValueError(
        f"{type(backbone).__name__} is not in backbones.registry.BACKBONES, so a file could "
        "not name it"
    )
