"""Things that stand on furniture or lie on the floor."""

import numpy as np

from instok3d.rooms import colors
from instok3d.rooms.colors import Number
from instok3d.rooms.materials import Maker, Material
from instok3d.rooms.objects.base import Furniture, Support, generator, standing
from instok3d.rooms.primitives import ball as sphere
from instok3d.rooms.primitives import box as block
from instok3d.rooms.primitives import cushion, cylinder, lathe, rod, rot_z


def _two_colored(make: Maker, kind: str, tile_m: Number) -> Material:
    first, second = colors.vivid(make.rng), colors.vivid(make.rng)
    if make.style.plain:
        return make.plain(kind, first)
    return make.pattern(kind, first, second, tile_m)


@generator
def box(make: Maker) -> Furniture:
    """A cardboard or coloured box with tape."""
    width, depth, height = (
        make.uniform(0.25, 0.55),
        make.uniform(0.22, 0.45),
        make.uniform(0.18, 0.45),
    )
    brown = colors.hsv(0.085, make.uniform(0.3, 0.5), make.uniform(0.5, 0.75))
    color = brown if make.chance(0.7) else colors.vivid(make.rng)
    tape = make.plain("plastic", colors.hsv(0.1, 0.3, 0.8), 0.0)
    parts = [
        block(
            (0, 0, height / 2), (width, depth, height), make.plain("cardboard", color, 0.03), 0.002
        ),
        block((0, 0, height), (0.05, depth * 0.99, 0.004), tape),
    ]
    x, y = width / 3, depth / 3
    return standing("box", parts, [Support(-x, -y, x, y, height + 0.002)])


@generator
def trash_can(make: Maker) -> Furniture:
    """An open bin."""
    radius, height = make.uniform(0.12, 0.2), make.uniform(0.28, 0.55)
    material = make.plastic() if make.chance(0.6) else make.metal()
    profile = [
        (radius * 0.8, 0), (radius, height), (radius * 0.93, height), (radius * 0.75, 0.03),
        (1e-4, 0.03),
    ]  # fmt: skip
    return standing("trash can", [lathe(profile, material, 22)])


@generator
def backpack(make: Maker) -> Furniture:
    """A backpack with a front pocket."""
    width, depth, height = (
        make.uniform(0.28, 0.42),
        make.uniform(0.15, 0.24),
        make.uniform(0.35, 0.5),
    )
    cloth = make.fabric()
    pocket = make.fabric() if make.chance(0.4) else cloth
    handle = height * 0.98, depth * 0.2
    parts = [
        cushion((0, 0, height / 2), (width, depth, height), cloth, 0.4, 0.4),
        cushion(
            (0, -depth * 0.45, height * 0.35),
            (width * 0.7, depth * 0.5, height * 0.5),
            pocket,
            0.4,
            0.4,
        ),
        rod((-0.04, handle[1], handle[0]), (0.04, handle[1], handle[0]), 0.012, cloth),
    ]
    return standing("backpack", parts)


@generator
def suitcase(make: Maker) -> Furniture:
    """A hard suitcase on four wheels."""
    width, depth, height = make.uniform(0.36, 0.5), make.uniform(0.2, 0.28), make.uniform(0.5, 0.7)
    shell, metal = make.plastic(), make.metal()
    z = height / 2 + 0.04
    parts = [block((0, 0, z), (width, depth, height), shell, 0.035)]
    for side in (-1, 1):
        band = (0.02, depth + 0.008, height * 0.96)
        parts.append(block((side * width / 4, 0, z), band, metal))
        parts += [
            cylinder((side * width * 0.4, y, 0), 0.025, 0.045, metal, 8)
            for y in (-depth * 0.35, depth * 0.35)
        ]
    return standing("suitcase", parts)


@generator
def ball(make: Maker) -> Furniture:
    """A ball in two colours."""
    radius = make.uniform(0.1, 0.18)
    return standing("ball", [sphere((0, 0, 0), radius, _two_colored(make, "rubber", 0.4), 24, 16)])


@generator
def vase(make: Maker) -> Furniture:
    """A turned vase."""
    height = make.uniform(0.16, 0.38)
    radius = height * make.uniform(0.15, 0.3)
    profile = [
        (radius * make.uniform(0.5, 1), 0), (radius * make.uniform(0.8, 1.4), height * 0.3),
        (radius * make.uniform(0.6, 1.2), height * 0.6),
        (radius * make.uniform(0.3, 0.6), height * 0.85),
        (radius * make.uniform(0.4, 0.8), height),
    ]  # fmt: skip
    clay = make.ceramic() if make.chance(0.6) else _two_colored(make, "ceramic", 0.15)
    return standing("vase", [lathe(profile, clay, 22, smooth=True)])


@generator
def bottle(make: Maker) -> Furniture:
    """A bottle with a label."""
    height, radius, glass = make.uniform(0.2, 0.32), make.uniform(0.03, 0.045), make.plastic()
    neck = radius * 0.35
    profile = [
        (radius, 0), (radius, height * 0.6), (neck, height * 0.75), (neck, height), (1e-4, height)
    ]  # fmt: skip
    label = make.label()
    band = [(radius * 1.02, height * 0.2), (radius * 1.02, height * 0.5)]
    return standing("bottle", [lathe(profile, glass, 16), lathe(band, label, 16)])


@generator
def cup(make: Maker) -> Furniture:
    """A cup with a handle."""
    height, radius, clay = make.uniform(0.08, 0.12), make.uniform(0.035, 0.05), make.ceramic()
    profile = [
        (radius * 0.8, 0), (radius, height), (radius * 0.88, height), (radius * 0.7, 0.01),
        (1e-4, 0.01),
    ]  # fmt: skip
    grip = (radius + 0.03, 0, height * 0.5)
    parts = [
        lathe(profile, clay, 18),
        rod((radius, 0, height * 0.25), grip, 0.007, clay, 6),
        rod((radius, 0, height * 0.8), grip, 0.007, clay, 6),
    ]
    return standing("cup", parts)


@generator
def bowl(make: Maker) -> Furniture:
    """A bowl, often with fruit."""
    radius = make.uniform(0.1, 0.16)
    height = radius * 0.6
    material = make.ceramic() if make.chance(0.6) else make.wood()
    profile = [
        (radius * 0.4, 0), (radius * 0.8, height * 0.45), (radius, height),
        (radius * 0.95, height), (radius * 0.7, height * 0.4), (1e-4, 0.02),
    ]  # fmt: skip
    parts = [lathe(profile, material, 24)]
    if make.chance(0.6):
        for _ in range(make.integer(3, 7)):
            angle, distance = make.uniform(0, 6.3), make.uniform(0.02, radius * 0.5)
            fruit = make.plain("fruit", colors.hsv(make.choice([0, 0.06, 0.12, 0.25]), 0.85, 0.85))
            center = (distance * np.cos(angle), distance * np.sin(angle), height * 0.8)
            parts.append(cushion(center, (0.075, 0.075, 0.07), fruit, 1, 1, 10, 8))
    return standing("bowl", parts)


@generator
def books(make: Maker) -> Furniture:
    """One to five books on a pile."""
    parts, z = [], 0.0
    for _ in range(make.integer(1, 6)):
        width, depth, thick = (
            make.uniform(0.15, 0.24),
            make.uniform(0.2, 0.3),
            make.uniform(0.015, 0.045),
        )
        cover, paper = (
            make.plain("paper", colors.vivid(make.rng)),
            make.plain("paper", np.array([0.92, 0.9, 0.82]), 0.02),
        )
        shift = (make.uniform(-0.01, 0.01), make.uniform(-0.01, 0.01), z + thick / 2)
        turn = rot_z(make.uniform(-0.25, 0.25))
        board, pages = thick * 0.12, (width * 0.96, depth * 0.97, thick * 0.76)
        for side in (-1, 1):
            center = (0, 0, side * (thick - board) / 2)
            parts.append(block(center, (width, depth, board), cover).moved(turn, shift))
        parts.append(
            block((-width * 0.02, 0, 0), (width * 0.96, depth, thick), cover).moved(turn, shift)
        )
        parts.append(block((width * 0.025, 0, 0), pages, paper).moved(turn, shift))
        z += thick
    return standing("books", parts)
