"""What hangs on the walls of lived-in rooms."""

import numpy as np

from instok3d.rooms import prints
from instok3d.rooms.materials import Maker, Material
from instok3d.rooms.objects.base import Furniture, generator, wall_mounted
from instok3d.rooms.objects.printed import printed_box, printed_quad
from instok3d.rooms.objects.storage import carcass
from instok3d.rooms.primitives import Part, box, cushion, drape, rod, tube


def _pinned(make: Maker, width: float, height: float, count: int, y: float) -> list[Part]:
    """Pages and cards within a rectangle around the origin, just before y."""
    parts: list[Part] = []
    for i in range(count):
        content = make.papers() if make.chance(0.7) else make.packages()
        size = make.uniform(0.07, 0.22), make.uniform(0.07, 0.3)
        w, h = min(size[0], width), min(size[1], height)
        x, z = make.uniform(0, width - w) - width / 2, make.uniform(0, height - h) - height / 2
        lift = y - 0.003 - 0.002 * i
        parts.append(printed_quad(make, (x, lift, z), (w, 0, 0), (0, 0, h), content))
    return parts


@generator
def notes(make: Maker) -> Furniture:
    """Papers stuck to the wall."""
    width, height = make.uniform(0.15, 0.9), make.uniform(0.2, 0.7)
    count = make.integer(1, 8)
    tack = box((0, -0.004, 0), (0.012, 0.008, 0.012), make.plastic())
    return wall_mounted("paper", [tack, *_pinned(make, width, height, count, 0.0)])


@generator
def pinboard(make: Maker) -> Furniture:
    """A board of cork or felt full of papers."""
    width, height = make.uniform(0.5, 1.2), make.uniform(0.4, 0.9)
    back = box((0, -0.01, 0), (width, 0.02, height), make.fabric())
    rim = make.furniture()
    rails = [box((0, -0.013, s * height / 2), (width + 0.03, 0.026, 0.025), rim) for s in (-1, 1)]
    posts = [box((s * width / 2, -0.013, 0), (0.025, 0.026, height), rim) for s in (-1, 1)]
    pages = _pinned(make, width - 0.04, height - 0.04, make.integer(3, 14), -0.02)
    return wall_mounted("whiteboard", [back, *rails, *posts, *pages])


@generator
def poster(make: Maker) -> Furniture:
    """A poster, calendar or map without a frame."""
    width, height = make.uniform(0.25, 0.8), make.uniform(0.35, 1.0)
    content = Material("paper", prints.poster(make.rng), tile_m=1)
    sheet = box((0, -0.004, 0), (width, 0.008, height), content)
    unit = sheet.vertices / np.array([width, 1, height]) + 0.5
    return wall_mounted("picture", [sheet.mapped(np.stack([unit[:, 0], unit[:, 2]], 1))])


@generator
def wall_cabinet(make: Maker) -> Furniture:
    """A cabinet or open box that hangs over a counter or desk."""
    width, depth, height = make.uniform(0.5, 1.6), make.uniform(0.22, 0.36), make.uniform(0.35, 0.7)
    if make.chance(0.6):
        body = carcass(make, width, depth, height)
        return wall_mounted("cabinet", body)
    wood, inside = make.furniture(), depth - 0.02
    parts = [box((0, -0.01, 0), (width, 0.02, height), wood)]
    for s in (-1, 1):
        parts.append(box((s * width / 2, -depth / 2, 0), (0.02, depth, height + 0.02), wood))
        parts.append(box((0, -depth / 2, s * height / 2), (width, depth, 0.02), wood))
    x = -width / 2 + 0.02
    while x < width / 2 - 0.1:
        size = make.uniform(0.05, 0.18), make.uniform(0.1, inside), make.uniform(0.3, 0.9) * height
        center = (x + size[0] / 2, -depth / 2, (size[2] - height) / 2 + 0.01)
        parts.append(printed_box(make, center, size, make.packages()))
        x += size[0] + make.uniform(0.003, 0.06)
    return wall_mounted("cabinet", parts)


def _hanging_cloth(make: Maker, width: float, length: float, cloth: Material) -> Part:
    x = np.linspace(-width / 2, width / 2, 20)
    swing = make.uniform(0.01, 0.025) * np.sin(np.linspace(0, make.uniform(6, 20), 20))
    return drape(np.stack([x, -0.04 + swing], 1), -length, 0.0, cloth)


@generator
def hung_towel(make: Maker) -> Furniture:
    """A towel on a rail or hook."""
    width, length = make.uniform(0.15, 0.5), make.uniform(0.3, 0.8)
    rail = rod((-width / 2 - 0.04, -0.04, 0), (width / 2 + 0.04, -0.04, 0), 0.009, make.metal())
    arms = [
        rod((s * (width / 2 + 0.03), 0, 0), (s * (width / 2 + 0.03), -0.05, 0), 0.009, make.metal())
        for s in (-1, 1)
    ]
    return wall_mounted("towel", [_hanging_cloth(make, width, length, make.fabric()), rail, *arms])


@generator
def hung_clothes(make: Maker) -> Furniture:
    """Coats on a row of hooks."""
    board, count = make.furniture(), make.integer(1, 4)
    span = 0.3 * count
    parts = [box((0, -0.01, 0.02), (span + 0.1, 0.02, 0.08), board)]
    for i in range(count):
        x, long, cloth = (i + 0.5) * 0.3 - span / 2, make.uniform(0.5, 0.9), make.fabric()
        parts.append(cushion((x, -0.09, -long / 2), (0.32, 0.16, long), cloth, 0.6, 0.6, 14, 8))
        parts.append(cushion((x, -0.12, -long * 0.3), (0.42, 0.1, long * 0.5), cloth, 0.8, 0.5, 12))
    return wall_mounted("clothes", parts)


@generator
def hung_bag(make: Maker) -> Furniture:
    """A bag on a hook."""
    width, height, cloth = make.uniform(0.2, 0.38), make.uniform(0.22, 0.4), make.fabric()
    body = cushion((0, -0.07, -height / 2 - 0.2), (width, 0.13, height), cloth, 0.4, 0.4, 14, 8)
    angle = np.linspace(0, np.pi, 10)
    straps = np.stack(
        [width * 0.3 * np.cos(angle), -0.05 + 0 * angle, -0.23 + 0.22 * np.sin(angle)], 1
    )
    hook = rod((0, 0, -0.005), (0, -0.07, 0.0), 0.008, make.metal(), 6)
    return wall_mounted("bag", [body, tube(straps, 0.01, cloth), hook])


@generator
def tool_rail(make: Maker) -> Furniture:
    """A rail with ladles, pans or tools."""
    width, metal = make.uniform(0.4, 1.0), make.metal()
    parts = [rod((-width / 2, -0.03, 0), (width / 2, -0.03, 0), 0.008, metal)]
    x = -width / 2 + 0.05
    while x < width / 2:
        length, radius = make.uniform(0.12, 0.3), make.uniform(0.02, 0.1)
        material = metal if make.chance(0.5) else make.plastic()
        parts.append(rod((x, -0.03, 0.0), (x, -0.03, -length), 0.007, material, 5))
        end = (x, -0.03, -length - radius * 0.8)
        parts.append(cushion(end, (2 * radius, 0.04, 2 * radius), material, 1, 1, 12, 6))
        x += radius + make.uniform(0.04, 0.14)
    parts.append(box((0, -0.016, 0), (0.03, 0.032, 0.03), metal))
    return wall_mounted("shelf", parts)
