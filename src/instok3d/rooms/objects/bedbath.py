"""Bedroom and bathroom: beds, pillows, toilets, sinks, bathtubs."""

import numpy as np

from instok3d.rooms import colors
from instok3d.rooms.colors import Number
from instok3d.rooms.materials import Maker, Material
from instok3d.rooms.objects.base import Furniture, generator, legs, standing
from instok3d.rooms.objects.storage import carcass
from instok3d.rooms.primitives import Part, box, cushion, lathe, rod, rot_x
from instok3d.rooms.textures import fabric


def _linen(make: Maker, saturation: Number, value: Number) -> Material:
    color = colors.hsv(make.rng.random(), make.uniform(0, saturation), make.uniform(value, 0.97))
    return Material("fabric", fabric(make.rng, color), 0.5)


@generator
def bed(make: Maker) -> Furniture:
    """A single or double bed with mattress, blanket and its own pillows."""
    width = make.choice([0.95, 1.2, 1.5, 1.7]) + make.uniform(-0.05, 0.05)
    depth, frame, mattress = (
        make.uniform(1.95, 2.12),
        make.uniform(0.18, 0.32),
        make.uniform(0.16, 0.26),
    )
    wood, board = make.furniture(), make.uniform(0.75, 1.25)
    parts = [*legs(False, width, depth, 0.12, 0.035, wood, 0.05)]
    parts.append(box((0, 0, frame - 0.06), (width, depth, 0.14), wood, 0.01))
    head = wood if make.chance(0.6) else make.fabric()
    parts.append(box((0, depth / 2 - 0.03, board / 2), (width + 0.04, 0.07, board), head, 0.02))
    if make.chance(0.4):
        size = (width + 0.02, 0.05, frame * 1.6)
        parts.append(box((0, -depth / 2 + 0.02, frame * 0.8), size, wood, 0.01))
    top, sheet = frame + mattress, _linen(make, 0.15, 0.8)
    size = (width * 0.98, depth - 0.1, mattress)
    parts.append(cushion((0, -0.02, frame + mattress / 2), size, sheet, 0.15, 0.08, 24, 8))
    cover = make.uniform(0.5, 0.75) * depth
    blanket = (width * 1.05, cover, 0.2)
    center = (0, -depth / 2 + 0.03 + cover / 2, top - 0.02)
    parts.append(cushion(center, blanket, make.fabric(), 0.3, 0.1, 24, 10))
    count, case = (1 if width < 1.1 else 2), _linen(make, 0.3, 0.7)
    for i in range(count):
        pillow = cushion(
            (0, 0, 0), (min(0.6, width / count * 0.88), 0.38, 0.15), case, 0.7, 0.5, 16, 10
        )
        x = (i - (count - 1) / 2) * width / count
        parts.append(pillow.moved(rot_x(0.15), (x, depth / 2 - 0.3, top + 0.06)))
    return standing("bed", parts)


@generator
def pillow(make: Maker) -> Furniture:
    """A pillow that leans back."""
    side = make.uniform(0.32, 0.48)
    size = (side, side * make.uniform(0.8, 1), 0.14)
    body = cushion((0, 0, 0), size, make.fabric(), 0.8, 0.45, 18, 10)
    return standing("pillow", [body.moved(rot_x(make.uniform(0.9, 1.3)))])


@generator
def toilet(make: Maker) -> Furniture:
    """A toilet with its tank, the lid up or down."""
    white, height = make.white("ceramic"), make.uniform(0.38, 0.44)
    profile = [(0.1, 0), (0.12, 0.05), (0.1, 0.15), (0.17, height - 0.08), (0.19, height)]
    tank = make.uniform(0.36, 0.44)
    parts = [
        lathe(profile, white, 24, smooth=True).scaled((1, 1.28, 1)),
        cushion((0, -0.02, height + 0.01), (0.38, 0.48, 0.05), white, 0.4, 0.8, 24, 6),
        box((0, 0.28, height + 0.17), (tank, 0.17, 0.36), white, 0.02),
        box((0, 0.28, height + 0.365), (tank + 0.02, 0.19, 0.03), white, 0.008),
        box((0, 0.22, height * 0.5), (0.2, 0.2, height), white, 0.02),
    ]
    if make.chance(0.4):
        lid = cushion((0, 0, 0), (0.37, 0.45, 0.04), white, 0.5, 0.8, 20, 6)
        parts.append(lid.moved(rot_x(np.pi / 2 - 0.12), (0, 0.15, height + 0.24)))
    return standing("toilet", parts)


def _tap(
    x: Number, y: Number, z: Number, reach: tuple[Number, Number], metal: Material
) -> list[Part]:
    spout = (x + reach[0], y + reach[1], z + 0.12)
    return [
        rod((x, y, z), (x, y, z + 0.14), 0.014, metal),
        rod((x, y, z + 0.14), spout, 0.012, metal),
    ]


@generator
def sink(make: Maker) -> Furniture:
    """A bathroom sink on a column or on a cabinet."""
    white, metal = make.white("ceramic"), make.metal()
    height, width = make.uniform(0.78, 0.88), make.uniform(0.45, 0.62)
    if make.chance(0.5):
        parts = [lathe([(0.11, 0), (0.08, 0.1), (0.07, height - 0.15)], white, 20, smooth=True)]
    else:
        parts = carcass(make, width * 0.95, 0.42, height - 0.14)
    parts.append(box((0, 0, height - 0.07), (width, 0.46, 0.14), white, 0.03))
    bowl = make.plain("ceramic", np.array([0.45, 0.46, 0.47]), 0.0)
    parts.append(cushion((0, -0.04, height), (width * 0.72, 0.3, 0.02), bowl, 0.5, 0.7))
    return standing("sink", parts + _tap(0, 0.17, height, (0, -0.12), metal))


@generator
def bathtub(make: Maker) -> Furniture:
    """A bathtub, half of them filled."""
    width, depth, height = make.uniform(1.5, 1.75), make.uniform(0.7, 0.82), make.uniform(0.48, 0.6)
    white, wall = make.white("enamel"), 0.07
    parts = [box((0, 0, 0.08), (width - 0.02, depth - 0.02, 0.1), white, 0.025)]
    for side in (-1, 1):
        long, short = (width, wall, height), (wall, depth, height)
        parts.append(box((0, side * (depth - wall) / 2, height / 2), long, white, 0.025))
        parts.append(box((side * (width - wall) / 2, 0, height / 2), short, white, 0.025))
    if make.chance(0.5):
        water = make.plain("water", np.array([0.6, 0.75, 0.78]), 0.02, gloss=0.2)
        parts.append(box((0, 0, height * 0.65), (width - 0.1, depth - 0.1, 0.01), water))
    return standing("bathtub", parts + _tap(width / 2 - 0.05, 0, height, (-0.15, 0), make.metal()))
