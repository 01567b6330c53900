"""On walls, windows and floors: pictures, mirrors, clocks, radiators, curtains, rugs, plants."""

import numpy as np

from instok3d.rooms import colors, pictures, textures
from instok3d.rooms.colors import Number
from instok3d.rooms.materials import Maker, Material
from instok3d.rooms.objects.base import Furniture, generator, standing, wall_mounted
from instok3d.rooms.primitives import (
    Part,
    box,
    cushion,
    cylinder,
    drape,
    grid,
    lathe,
    quad,
    rod,
    rot_x,
    rot_z,
)


def _framed(make: Maker, name: str, width: Number, height: Number, content: Material) -> Furniture:
    border, thickness, wood = make.uniform(0.012, 0.05), 0.025, make.furniture()
    parts = []
    for side in (-1, 1):
        rail = (width + 2 * border, thickness, border)
        post = (border, thickness, height)
        z, x = side * (height + border) / 2, side * (width + border) / 2
        parts.append(box((0, -thickness / 2, z), rail, wood, 0.004))
        parts.append(box((x, -thickness / 2, 0), post, wood, 0.004))
    corner = (-width / 2, -0.008, -height / 2)
    parts.append(quad(corner, (width, 0, 0), (0, 0, height), content))
    return wall_mounted(name, parts)


@generator
def picture(make: Maker) -> Furniture:
    """A framed picture."""
    width, height = make.uniform(0.3, 1.1), make.uniform(0.3, 0.8)
    return _framed(make, "picture", width, height, Material("paper", pictures.art(make.rng)))


@generator
def mirror(make: Maker) -> Furniture:
    """A framed mirror."""
    width, height = make.uniform(0.3, 0.9), make.uniform(0.4, 0.9)
    glass = Material("glass", pictures.mirror(make.rng), gloss=0.45)
    return _framed(make, "mirror", width, height, glass)


@generator
def whiteboard(make: Maker) -> Furniture:
    """A whiteboard with a tray."""
    width, height, metal = make.uniform(0.9, 1.8), make.uniform(0.6, 1.1), make.metal()
    board = Material("enamel", pictures.whiteboard(make.rng), gloss=0.12)
    parts = [
        box((0, -0.01, 0), (width + 0.04, 0.02, height + 0.04), metal, 0.004),
        quad((-width / 2, -0.0205, -height / 2), (width, 0, 0), (0, 0, height), board),
        box((0, -0.04, -height / 2), (width * 0.5, 0.06, 0.015), metal),
    ]
    return wall_mounted("whiteboard", parts)


@generator
def clock(make: Maker) -> Furniture:
    """A round wall clock."""
    radius = make.uniform(0.12, 0.2)
    rim = cylinder((0, 0, 0), radius, 0.03, make.furniture(), 32)
    dial = Material("paper", pictures.clock_face(make.rng))
    face = cylinder((0, 0, 0.025), radius * 0.9, 0.008, dial, 32)
    face = face.mapped(face.vertices[:, :2] / (1.8 * radius) + 0.5)
    turn = rot_x(np.pi / 2)
    return wall_mounted("clock", [rim.moved(turn), face.moved(turn)])


@generator
def radiator(make: Maker) -> Furniture:
    """A ribbed radiator."""
    width, height, white = make.uniform(0.6, 1.3), make.uniform(0.4, 0.6), make.white()
    count = int(width / 0.07)
    pitch = width / count
    parts = [
        box(
            (-width / 2 + pitch * (i + 0.5), 0, 0.12 + height / 2),
            (pitch * 0.72, 0.08, height),
            white,
            0.01,
        )
        for i in range(count)
    ]
    parts += [
        box((0, 0, 0.12 + z), (width - 0.02, 0.05, 0.04), white) for z in (0.05, height - 0.05)
    ]
    parts += [box((x, 0, 0.08), (0.03, 0.04, 0.16), white) for x in (-width / 3, width / 3)]
    return standing("radiator", parts)


def hung_cloth(
    make: Maker, width: Number, bottom: Number, top: Number, folds: Number
) -> list[Part]:
    """A pleated cloth under a rod, centred at the origin."""
    x = np.linspace(-width / 2, width / 2, 48)
    phase = 2 * np.pi * folds * np.linspace(0, 1, len(x)) + make.uniform(0, 6)
    outline = np.stack([x, 0.028 * np.sin(phase)], 1)
    bar = rod(
        (-width / 2 - 0.03, 0, top + 0.01), (width / 2 + 0.03, 0, top + 0.01), 0.011, make.metal()
    )
    return [drape(outline, bottom, top, make.fabric()), bar]


def curtain_of(make: Maker, width: Number, bottom: Number, top: Number) -> Furniture:
    """A curtain of a given size; `bottom` and `top` are heights above the floor."""
    return wall_mounted(
        "curtain", hung_cloth(make, width, bottom, top, max(2, round(width / 0.11)))
    )


@generator
def curtain(make: Maker) -> Furniture:
    """A curtain as wide as one side of a window."""
    return curtain_of(make, make.uniform(0.3, 0.55), 0.04, make.uniform(1.9, 2.25))


@generator
def shower_curtain(make: Maker) -> Furniture:
    """A curtain on its own rod, a hand above the floor."""
    width, top = make.uniform(0.9, 1.5), make.uniform(1.75, 1.95)
    cloth = hung_cloth(make, width, 0.15, top, make.integer(4, 9))
    metal = make.metal()  # posts carry the rod where no bathtub does
    posts = [
        rod((x, 0, 0), (x, 0, top + 0.02), 0.012, metal)
        for x in (-width / 2 - 0.02, width / 2 + 0.02)
    ]
    return standing("shower curtain", cloth + posts)


@generator
def rug(make: Maker) -> Furniture:
    """A rectangular or round rug."""
    width, depth, height = make.uniform(1.2, 2.4), make.uniform(0.8, 1.7), 0.012
    material = Material("fabric", textures.rug(make.rng))
    if make.chance(0.2):
        radius = depth / 2 + 0.2
        body = cylinder((0, 0, 0), radius, height, material, 40)
        size = (2 * radius, 2 * radius)
    else:
        body, size = box((0, 0, height / 2), (width, depth, height), material), (width, depth)
    return standing("rug", [body.mapped(body.vertices[:, :2] / size + 0.5)])


def _leaf(make: Maker, length: Number, wide: bool, base: Number, material: Material) -> Part:
    """A leaf that rises from the origin and droops at its tip."""
    slope = make.uniform(0.3, 1.5)
    width = length * make.uniform(0.12, 0.3) if wide else 0.05
    t = np.linspace(0, 1, 5)
    x = length * t * np.cos(slope)
    z = length * (np.sin(slope) * t - 0.35 * t**2 * (1.6 - slope))
    half = width * np.sin(np.pi * (0.08 + 0.9 * t))
    rows = [np.stack([x, s * half, z - 0.3 * half * (s == 0)], 1) for s in (-1, 0, 1)]
    dx, dz = np.gradient(x), np.gradient(z)
    normal = np.stack([-dz, 0 * dx, dx], 1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    uvs = np.stack([np.tile(t * length, (3, 1)), np.tile([[-width], [0], [width]], (1, 5))], -1)
    leaf = grid(np.stack(rows), np.tile(normal, (3, 1, 1)), uvs, material)
    return leaf.moved(rot_z(make.uniform(0, 2 * np.pi)), (0, 0, base))


def _bush(make: Maker, size: Number, pot: Number, leaves: Material, count: int) -> list[Part]:
    """A trunk with flat blobs of leaves around its top."""
    spread = make.uniform(0.3, 0.5) * size * 0.8
    parts = [rod((0, 0, pot), (0, 0, size * 0.6), size * 0.015, make.wood())]
    for _ in range(count):
        direction = make.rng.normal(0, 1, 3)
        direction /= np.linalg.norm(direction)
        blob = cushion(
            (0, 0, 0), (spread * 0.5, spread * 0.35, spread * 0.12), leaves, 0.9, 0.9, 8, 5
        )
        turn = rot_z(make.uniform(0, 6.3)) @ rot_x(make.uniform(-1, 1))
        parts.append(blob.moved(turn, np.array([0, 0, size * 0.75]) + direction * size * 0.22))
    return parts


def _plant(make: Maker, size: Number, pot_radius: Number) -> Furniture:
    pot = pot_radius * make.uniform(1.2, 2)
    clay = make.ceramic() if make.chance(0.8) else make.wood()
    profile = [
        (pot_radius * make.uniform(0.6, 0.9), 0), (pot_radius, pot), (pot_radius * 0.9, pot),
        (pot_radius * 0.9, pot - 0.02), (1e-4, pot - 0.02),
    ]  # fmt: skip
    parts = [lathe(profile, clay, 20)]
    green = colors.hsv(make.uniform(0.22, 0.4), make.uniform(0.4, 0.8), make.uniform(0.25, 0.6))
    leaves = make.plain("leaves", green, 0.12, tile_m=0.3)
    count, kind = make.integer(14, 34), make.integer(0, 3)
    if kind == 2:
        return standing("plant", parts + _bush(make, size, pot - 0.02, leaves, count))
    length = make.uniform(0.3, 0.5) * (size - pot)
    for _ in range(count):
        parts.append(_leaf(make, length * make.uniform(0.9, 2), kind == 0, pot - 0.02, leaves))
    return standing("plant", parts)


@generator
def plant(make: Maker) -> Furniture:
    """A pot plant for the floor."""
    size = make.uniform(0.5, 1.3)
    return _plant(make, size, size * make.uniform(0.12, 0.2))


@generator
def small_plant(make: Maker) -> Furniture:
    """A pot plant for a table."""
    size = make.uniform(0.14, 0.3)
    return _plant(make, size, size * 0.24)
