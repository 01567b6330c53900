"""The geometry backbones that a file, a stage or a command may name, imported when one does.

There are three of this package. Others are registered by a call (`register_backbone`), or found as
entry points of installed packages, so that commands know them too.
"""

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from torch import Tensor

from instok3d.backbones.base import BackboneConfig, GeometryBackbone
from instok3d.backbones.cost import Activations, Outline, Work

ENTRY_POINTS = "instok3d.backbones"
"""Group in the metadata of a package that brings a backbone."""


@dataclass(frozen=True)
class BackboneKind:
    """A backbone class, and all that the rest of the package asks of it beside running it."""

    backbone: type[GeometryBackbone]
    config: type[BackboneConfig]
    """The frozen dataclass of its sizes, from which it is made: `backbone(config)`."""
    activations: Callable[[Any, Work], Activations] | None = None
    """Memory that it takes while it runs, of a config; None where nobody counted."""
    outline: Callable[[Any], Outline] | None = None
    """Of a config, for a class that cannot be built on torch's meta device; None where it can."""
    load_published: Callable[[Any, Mapping[str, Tensor]], bool] | None = None
    """Fills a backbone from weights under other names than its own, as somebody published them;
    False if these are none."""
    added_later: Mapping[str, Any] = field(default_factory=dict)
    """Sizes that files of models may lack, and what such a file was made with."""


def _nano() -> BackboneKind:
    from instok3d.backbones.nano.activations import nano_activations
    from instok3d.backbones.nano.backbone import NanoBackbone, NanoConfig

    return BackboneKind(
        NanoBackbone,
        NanoConfig,
        activations=nano_activations,
        added_later={"refinement_layers": 0},
    )


def _vggt() -> BackboneKind:
    from instok3d.backbones.vggt import VGGTBackbone, VGGTConfig
    from instok3d.backbones.vggt.activations import vggt_activations
    from instok3d.backbones.vggt.weights import fill_from_published

    return BackboneKind(
        VGGTBackbone,
        VGGTConfig,
        activations=vggt_activations,
        load_published=fill_from_published,
    )


def _depth_anything_3() -> BackboneKind:
    from instok3d.backbones import depth_anything3

    return BackboneKind(
        depth_anything3.DepthAnything3Backbone,
        depth_anything3.DepthAnything3Config,
        activations=depth_anything3.depth_anything3_activations,
        outline=depth_anything3.depth_anything3_outline,
        load_published=depth_anything3.fill_from_published,
    )


OWN: dict[str, Callable[[], BackboneKind]] = {
    "nano": _nano,
    "vggt": _vggt,
    "depth-anything-3": _depth_anything_3,
}
"""The backbones of this package."""

_REGISTERED: dict[str, BackboneKind] = {}


def register_backbone(name: str, kind: BackboneKind) -> None:
    """Make a backbone known in this process: to files of models, to runs and to `build_backbone`.

    A package that is to work with the commands names the kind as an entry point instead
    (docs/backbones.md).

    Args:
        name: Stands in files of models.
        kind: The backbone.

    Raises:
        ValueError: There is another one of that name, or the kind is not what it must be.
    """
    _check(name, kind)
    if name in OWN or _REGISTERED.get(name, kind) != kind:
        raise ValueError(f"there is a backbone {name!r} already: register yours by another name")
    _REGISTERED[name] = kind


def backbone_names() -> list[str]:
    """The names of all backbones that are known."""
    return sorted({*OWN, *_REGISTERED, *_entry_points()})


def kind_named(name: str) -> BackboneKind:
    """The backbone of that name.

    Raises:
        ValueError: There is none, or the package that brings it cannot be used.
    """
    if name in OWN:
        return OWN[name]()
    if name in _REGISTERED:
        return _REGISTERED[name]
    point = _entry_points().get(name)
    if point is None:
        raise ValueError(f"no backbone is called {name!r}; there are {', '.join(backbone_names())}")
    try:
        kind = point.load()
    except (ImportError, AttributeError) as error:
        raise ValueError(
            f"the backbone {name!r} is {point.value} of {_package(point)}, which cannot be "
            f"imported: {error}"
        ) from error
    _check(name, kind)
    return kind


def kind_of(config: BackboneConfig) -> BackboneKind:
    """The backbone that is made from this dataclass.

    Raises:
        ValueError: None is.
    """
    for _, kind in _kinds():
        if type(config) is kind.config:
            return kind
    raise ValueError(
        f"no backbone is made from a {type(config).__name__}: register it (docs/backbones.md), or "
        f"give the config of one of {', '.join(backbone_names())}"
    )


def config_named(name: str) -> type[BackboneConfig]:
    """The dataclass of that class name, by which runs name the sizes of their backbone.

    Raises:
        ValueError: No backbone has it, or more than one.
    """
    found = {kind.config for _, kind in _kinds() if kind.config.__name__ == name}
    if len(found) != 1:
        raise ValueError(
            f"{'no backbone is' if not found else 'more than one backbone is'} made from a {name}; "
            f"there are {', '.join(backbone_names())}"
        )
    return found.pop()


def build_backbone(config: BackboneConfig) -> GeometryBackbone:
    """A new backbone of these sizes, with random weights.

    Args:
        config: The dataclass of one of the registered kinds, e.g. NanoConfig or VGGTConfig.

    Raises:
        ValueError: No registered backbone is made from such a dataclass.
    """
    return kind_of(config).backbone(config)  # pyright: ignore[reportCallIssue]


def name_of(backbone: GeometryBackbone) -> str:
    """The name under which this backbone's class is registered.

    Raises:
        ValueError: Its class is not registered.
    """
    for name, kind in _kinds():
        if type(backbone) is kind.backbone:
            return name
    raise ValueError(
        f"{type(backbone).__name__} is not registered (docs/backbones.md), so a file could not "
        "name it"
    )


def _kinds() -> Iterator[tuple[str, BackboneKind]]:
    """All backbones, those of packages last: one that cannot be used harms no other one."""
    for name in OWN:
        yield name, OWN[name]()
    yield from _REGISTERED.items()
    for name in _entry_points():
        try:
            yield name, kind_named(name)
        except ValueError as error:
            warnings.warn(str(error), stacklevel=3)


def _entry_points() -> dict[str, EntryPoint]:
    found: dict[str, EntryPoint] = {}
    for point in entry_points(group=ENTRY_POINTS):
        if point.name in OWN or point.name in _REGISTERED or point.name in found:
            warnings.warn(
                f"the backbone {point.name!r} of {_package(point)} is left out: there is another "
                "one of that name",
                stacklevel=3,
            )
        else:
            found[point.name] = point
    return found


def _package(point: EntryPoint) -> str:
    return "an installed package" if point.dist is None else f"the package {point.dist.name}"


def _check(name: str, kind: Any) -> None:
    """Fail unless a kind is one, with a frozen dataclass whose class name no other has."""
    if not isinstance(kind, BackboneKind):
        raise ValueError(f"the backbone {name!r} is a {type(kind).__name__}, wanted a BackboneKind")
    config = kind.config
    if not issubclass(config, BackboneConfig) or "__dataclass_params__" not in vars(config):
        raise ValueError(
            f"the sizes of the backbone {name!r} are a {config.__name__}; wanted a frozen "
            "dataclass that inherits from instok3d.backbones.BackboneConfig"
        )
    for owner, load in OWN.items():
        if load().config.__name__ == config.__name__:
            raise ValueError(
                f"the sizes of the backbone {name!r} are a {config.__name__}, as those of {owner}; "
                "runs tell them by the name of their class, so it must be another"
            )
