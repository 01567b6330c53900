"""What a generator returns, the registry of generators, and parts that many of them share."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from instok3d.rooms.colors import Number
from instok3d.rooms.materials import Maker, Material
from instok3d.rooms.primitives import Part, box, rod


@dataclass(frozen=True)
class Support:
    """A level rectangle on which things may stand, in the object's own frame."""

    x0: Number
    y0: Number
    x1: Number
    y1: Number
    z: Number


@dataclass(frozen=True)
class Furniture:
    """An object in its own frame: x to its right, y to its back, z up, metres."""

    name: str
    """Class, one of CLASSES."""
    parts: tuple[Part, ...]
    size: tuple[Number, Number, Number]
    """Exact width, depth, height of the box around the parts."""
    supports: tuple[Support, ...] = ()
    source: str = ""
    """Where the shape comes from, if not from a generator: "model:chair1"."""


Generate = Callable[[Maker], Furniture]

REGISTRY: dict[str, Generate] = {}
"""Every generator by its name."""

HELD_OUT_GENERATORS = ("piano", "bench", "suitcase", "telephone")
"""Generators that only transfer rooms use."""


def generator(generate: Generate) -> Generate:
    """Register a generator under its function's name."""
    REGISTRY[generate.__name__] = generate
    return generate


def _bounds(parts: Iterable[Part]) -> tuple[np.ndarray, np.ndarray]:
    vertices = np.concatenate([part.vertices for part in parts])
    return vertices.min(0), vertices.max(0)


def _anchored(
    name: str, parts: list[Part], supports: Iterable[Support], anchor: tuple[Number, Number, Number]
) -> Furniture:
    """Shift the parts so that the point at these fractions of their box is the origin."""
    low, high = _bounds(parts)
    shift = -(low + (high - low) * np.array(anchor))
    dx, dy, dz = (float(x) for x in shift)
    size = tuple(float(x) for x in high - low)
    return Furniture(
        name,
        tuple(part.moved(offset=shift) for part in parts),
        (size[0], size[1], size[2]),
        tuple(Support(s.x0 + dx, s.y0 + dy, s.x1 + dx, s.y1 + dy, s.z + dz) for s in supports),
    )


def fixed(name: str, parts: list[Part]) -> Furniture:
    """A part of the room's shell: left where it is."""
    low, high = _bounds(parts)
    width, depth, height = (float(x) for x in high - low)
    return Furniture(name, tuple(parts), (width, depth, height))


def standing(name: str, parts: list[Part], supports: Iterable[Support] = ()) -> Furniture:
    """An object whose origin is the middle of its footprint."""
    return _anchored(name, parts, supports, (0.5, 0.5, 0.0))


def wall_mounted(name: str, parts: list[Part]) -> Furniture:
    """An object whose origin is the middle of its back."""
    return _anchored(name, parts, (), (0.5, 1.0, 0.5))


def hanging(name: str, parts: list[Part]) -> Furniture:
    """An object whose origin is the middle of its top."""
    return _anchored(name, parts, (), (0.5, 0.5, 1.0))


def legs(
    round_legs: bool,
    width: Number,
    depth: Number,
    height: Number,
    radius: Number,
    material: Material,
    inset: Number = 0.04,
    splay: Number = 0.0,
) -> list[Part]:
    """Four legs under a rectangle; round ones may splay outwards towards the floor."""
    parts = []
    for sx in (-1, 1):
        for sy in (-1, 1):
            x, y = sx * (width / 2 - inset), sy * (depth / 2 - inset)
            if round_legs:
                foot = (x + sx * splay, y + sy * splay, 0.0)
                parts.append(rod(foot, (x, y, height), radius, material, 8))
            else:
                side = 2 * radius
                parts.append(box((x, y, height / 2), (side, side, height), material, 0.004))
    return parts
