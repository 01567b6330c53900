"""White goods and kitchen machines."""

import numpy as np

from instok3d.rooms.colors import Number
from instok3d.rooms.materials import Maker, Material
from instok3d.rooms.objects.base import Furniture, Support, generator, standing
from instok3d.rooms.primitives import Part, box, cushion, cylinder, rot_x


def _body(make: Maker) -> Material:
    return make.white() if make.chance(0.5) else make.metal()


def _knob(x: Number, y: Number, z: Number, radius: Number, material: Material) -> Part:
    """A short cylinder that sticks out of a front at y."""
    disc = cylinder((0, 0, 0), radius, 0.03, material, 10 if radius < 0.1 else 28)
    return disc.moved(rot_x(np.pi / 2), (x, y, z))


@generator
def refrigerator(make: Maker) -> Furniture:
    """A fridge with two doors, one above the other."""
    width, depth, height = (
        make.uniform(0.55, 0.85),
        make.uniform(0.6, 0.72),
        make.uniform(1.45, 1.9),
    )
    body, handle, split = _body(make), make.metal(), make.uniform(0.3, 0.7)
    parts = [box((0, 0.02, height / 2), (width, depth - 0.05, height), body, 0.01)]
    for low, high in ((0.04, height * split - 0.008), (height * split + 0.008, height - 0.005)):
        z, tall = (low + high) / 2, high - low
        parts.append(box((0, -depth / 2 + 0.03, z), (width, 0.06, tall), body, 0.012))
        grip = (0.022, 0.03, min(0.4, tall * 0.6))
        parts.append(box((-width / 2 + 0.06, -depth / 2 - 0.015, z), grip, handle, 0.005))
    return standing("refrigerator", parts)


@generator
def washing_machine(make: Maker) -> Furniture:
    """A front loader."""
    width, depth, height = (
        make.uniform(0.56, 0.64),
        make.uniform(0.52, 0.62),
        make.uniform(0.82, 0.9),
    )
    body, glass = make.white(), make.plastic(np.array([0.1, 0.12, 0.15]))
    front, z = -depth / 2, height * 0.45
    parts = [
        box((0, 0, height / 2), (width, depth, height), body, 0.012),
        _knob(0, front + 0.01, z, 0.2, make.metal()),
        cushion((0, front - 0.02, z), (0.31, 0.05, 0.31), glass, 1, 1),
        box((0, front - 0.002, height - 0.07), (width - 0.06, 0.01, 0.08), glass),
    ]
    return standing("washing machine", parts, [Support(-0.2, -0.2, 0.2, 0.2, height)])


@generator
def oven(make: Maker) -> Furniture:
    """A stove: oven door, four knobs, four plates."""
    width, depth, height = (
        make.uniform(0.56, 0.64),
        make.uniform(0.56, 0.62),
        make.uniform(0.84, 0.92),
    )
    black, front = make.dark(), -depth / 2
    parts = [
        box((0, 0, height / 2), (width, depth, height), _body(make), 0.006),
        box((0, front - 0.005, height * 0.42), (width * 0.82, 0.02, height * 0.42), black, 0.004),
        box((0, front - 0.035, height * 0.7), (width * 0.8, 0.02, 0.02), make.metal()),
    ]
    for i in range(4):
        parts.append(_knob(-width / 3 + width / 4.5 * i, front, height * 0.86, 0.022, black))
    for x in (-0.14, 0.14):
        parts += [cylinder((x, y, height), 0.085, 0.01, black, 18) for y in (-0.13, 0.13)]
    return standing("oven", parts)


@generator
def microwave(make: Maker) -> Furniture:
    """A microwave oven."""
    width, depth, height = (
        make.uniform(0.44, 0.55),
        make.uniform(0.32, 0.4),
        make.uniform(0.26, 0.32),
    )
    black, tall = make.dark(), height * 0.75
    parts = [
        box((0, 0, height / 2), (width, depth, height), _body(make), 0.006),
        box((-width * 0.1, -depth / 2, height / 2), (width * 0.66, 0.012, tall), black),
        box((width * 0.38, -depth / 2, height / 2), (width * 0.16, 0.012, tall), black),
    ]
    return standing("microwave", parts)


@generator
def toaster(make: Maker) -> Furniture:
    """A toaster with two slots."""
    width, depth, height = (
        make.uniform(0.25, 0.32),
        make.uniform(0.16, 0.2),
        make.uniform(0.17, 0.2),
    )
    body = make.metal() if make.chance(0.5) else make.plastic()
    black = make.dark()
    parts = [box((0, 0, height / 2), (width, depth, height), body, 0.03)]
    parts += [box((0, y, height), (width * 0.7, 0.025, 0.006), black) for y in (-0.03, 0.03)]
    return standing("toaster", parts)
