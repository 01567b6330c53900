"""What lies about on desks, tables, counters and shelves of lived-in rooms."""

import numpy as np

from instok3d.rooms.colors import Number
from instok3d.rooms.materials import Maker, Material
from instok3d.rooms.objects.base import Furniture, generator, standing
from instok3d.rooms.objects.printed import printed_band, printed_box, printed_quad, sheets
from instok3d.rooms.objects.storage import books_row
from instok3d.rooms.primitives import (
    Part,
    ball,
    box,
    cushion,
    cylinder,
    lathe,
    rod,
    rot_x,
    rot_z,
    tube,
)


@generator
def papers(make: Maker) -> Furniture:
    """One to six sheets of paper, neatly or all over the place."""
    count = make.integer(1, 7)
    size = (0.21, 0.297) if make.chance(0.7) else (make.uniform(0.08, 0.16), make.uniform(0.1, 0.2))
    return standing("paper", sheets(make, count, size, make.uniform(0.0, 0.12)))


@generator
def magazines(make: Maker) -> Furniture:
    """One to three magazines or notebooks."""
    covers, parts, z = make.packages(), [], 0.0
    for _ in range(make.integer(1, 4)):
        size = make.uniform(0.15, 0.23), make.uniform(0.2, 0.3), make.uniform(0.006, 0.018)
        flat = printed_box(make, (0, 0, 0), size, covers)
        offset = make.uniform(-0.04, 0.04), make.uniform(-0.04, 0.04), z + size[2] / 2
        parts.append(flat.moved(rot_z(make.uniform(-0.5, 0.5)), offset))
        z += size[2]
    return standing("books", parts)


@generator
def book_stack(make: Maker) -> Furniture:
    """Two to eight books on each other, with printed covers."""
    covers, z, parts = make.packages(), 0.0, []
    pages = make.plain("paper", 0.85, 0.0)
    for _ in range(make.integer(2, 9)):
        size = make.uniform(0.13, 0.22), make.uniform(0.18, 0.28), make.uniform(0.015, 0.05)
        block = (size[0], size[1] - 0.012, size[2] * 0.75)
        offset = make.uniform(-0.015, 0.015), make.uniform(-0.015, 0.015), z + size[2] / 2
        turn = rot_z(make.uniform(-0.2, 0.2))
        parts.append(printed_box(make, (0, 0, 0), size, covers).moved(turn, offset))
        parts.append(box((0.006, 0, 0), block, pages).moved(turn, offset))
        z += size[2]
    return standing("books", parts)


@generator
def standing_books(make: Maker) -> Furniture:
    """A row of books that stand, the last one leaning."""
    width, depth, height = make.uniform(0.12, 0.4), make.uniform(0.13, 0.2), make.uniform(0.18, 0.3)
    parts = [books_row(make, -width / 2, width, depth, 0.0, height, 0.0)]
    leaning = printed_box(make, (0, 0, height / 2), (0.025, depth, height), make.packages())
    tilt = make.uniform(0.15, 0.4)
    turn = rot_z(np.pi / 2) @ rot_x(tilt) @ rot_z(-np.pi / 2)
    shift = (width / 2 + 0.0125 + height * np.sin(tilt), 0, 0.013 * np.sin(tilt))
    parts.append(leaning.moved(turn, shift))
    return standing("books", parts)


@generator
def package(make: Maker) -> Furniture:
    """A printed packet: cereal, tea, tissues, electronics."""
    size = make.uniform(0.06, 0.24), make.uniform(0.04, 0.16), make.uniform(0.04, 0.3)
    return standing("box", [printed_box(make, (0, 0, size[2] / 2), size, make.packages())])


@generator
def packages(make: Maker) -> Furniture:
    """Two or three packets side by side or on each other."""
    covers, parts, x = make.packages(), [], 0.0
    for _ in range(make.integer(2, 4)):
        size = make.uniform(0.05, 0.16), make.uniform(0.05, 0.15), make.uniform(0.05, 0.26)
        center = (x + size[0] / 2, make.uniform(-0.03, 0.03), size[2] / 2)
        parts.append(printed_box(make, center, size, covers))
        x += size[0] + 0.004
    return standing("box", parts)


def _jar(make: Maker, radius: Number, height: Number, body: Material) -> list[Part]:
    label = printed_band(make, radius * 1.02, height * 0.15, height * 0.75, make.label())
    lid = cylinder((0, 0, height), radius * 0.9, height * 0.12, make.plastic(), 14)
    return [cylinder((0, 0, 0), radius, height, body, 14), label, lid]


@generator
def jar(make: Maker) -> Furniture:
    """A jar, can or spray bottle with a label."""
    radius, height = make.uniform(0.025, 0.055), make.uniform(0.08, 0.24)
    return standing("bottle", _jar(make, radius, height, make.plastic()))


@generator
def glass(make: Maker) -> Furniture:
    """A tumbler or paper cup."""
    height, radius, wall = make.uniform(0.08, 0.15), make.uniform(0.03, 0.042), make.ceramic()
    profile = [(radius * 0.75, 0), (radius, height), (radius * 0.9, height), (1e-4, 0.012)]
    return standing("cup", [lathe(profile, wall, 14)])


@generator
def pen_holder(make: Maker) -> Furniture:
    """A cup of pens, brushes or kitchen tools."""
    radius, height, long = make.uniform(0.035, 0.055), make.uniform(0.09, 0.14), make.chance(0.4)
    parts = [cylinder((0, 0, 0), radius, height, make.plastic(), 14)]
    for _ in range(make.integer(3, 9)):
        lean, angle = make.uniform(0.2, 0.9) * radius, make.uniform(0, 6.3)
        foot = (lean * np.cos(angle), lean * np.sin(angle))
        top = height + make.uniform(0.04, 0.18 if long else 0.09)
        end = (1.7 * foot[0], 1.7 * foot[1], top)
        parts.append(rod((foot[0], foot[1], height - 0.02), end, 0.005, make.plastic(), 5))
        if long and make.chance(0.5):
            parts.append(ball(end, 0.022, parts[-1].material, 8, 6))
    return standing("cup", parts)


@generator
def plates(make: Maker) -> Furniture:
    """A pile of plates or bowls."""
    radius, clay, parts = make.uniform(0.08, 0.14), make.ceramic(), []
    for i in range(make.integer(1, 7)):
        rim = radius * make.uniform(0.92, 1.0)
        profile = [(rim * 0.55, 0), (rim, 0.02), (rim * 0.97, 0.024), (1e-4, 0.008)]
        parts.append(lathe(profile, clay, 18, (0, 0, 0.014 * i)))
    return standing("bowl", parts)


@generator
def folded_towels(make: Maker) -> Furniture:
    """One to four folded towels or clothes on each other."""
    parts, z = [], 0.0
    for _ in range(make.integer(1, 5)):
        size = make.uniform(0.22, 0.34), make.uniform(0.18, 0.28), make.uniform(0.03, 0.07)
        center = (make.uniform(-0.015, 0.015), 0, z + size[2] / 2)
        parts.append(cushion(center, size, make.fabric(), 0.5, 0.25, 14, 6))
        z += size[2] * 0.85
    return standing("towel", parts)


@generator
def cloth(make: Maker) -> Furniture:
    """A towel or garment thrown down: a heap with folds."""
    size, fabric, parts = make.uniform(0.15, 0.4), make.fabric(), []
    for _ in range(make.integer(3, 7)):
        part = (size * make.uniform(0.4, 0.9), size * make.uniform(0.25, 0.6), size * 0.25)
        place = make.rng.uniform(-0.3, 0.3, 2) * size
        lump = cushion((0, 0, 0), part, fabric, 0.9, 0.7, 12, 6)
        turn = rot_z(make.uniform(0, 3.1)) @ rot_x(make.uniform(-0.3, 0.3))
        parts.append(lump.moved(turn, (place[0], place[1], size * 0.12)))
    return standing("clothes", parts)


@generator
def picture_stand(make: Maker) -> Furniture:
    """A photo in a frame, or a leaflet in a stand, that leans back."""
    width, height = make.uniform(0.1, 0.24), make.uniform(0.12, 0.3)
    border, frame = make.uniform(0.004, 0.02), make.furniture()
    content = make.packages() if make.chance(0.5) else make.papers()
    back = box((0, 0.008, height / 2), (width + 2 * border, 0.014, height + 2 * border), frame)
    face = printed_quad(make, (-width / 2, -1e-3, 0), (width, 0, 0), (0, 0, height), content)
    tilt = rot_x(-make.uniform(0.08, 0.35))
    prop = rod((0, 0.1, 0), (0, 0.02, height * 0.6), 0.006, frame, 5)
    return standing("picture", [back.moved(tilt), face.moved(tilt), prop])


@generator
def basket(make: Maker) -> Furniture:
    """A tray or basket with odds and ends in it."""
    width, depth, height = make.uniform(0.2, 0.4), make.uniform(0.15, 0.3), make.uniform(0.05, 0.16)
    side = make.plastic() if make.chance(0.5) else make.fabric()
    parts = [box((0, 0, 0.005), (width, depth, 0.01), side)]
    for s in (-1, 1):
        parts.append(box((s * (width / 2 - 0.005), 0, height / 2), (0.01, depth, height), side))
        parts.append(box((0, s * (depth / 2 - 0.005), height / 2), (width, 0.01, height), side))
    for _ in range(make.integer(3, 9)):
        size = make.rng.uniform(0.03, 0.1, 3)
        room = np.array([width - 0.14, depth - 0.14])
        x, y = make.rng.uniform(-0.5, 0.5, 2) * np.maximum(room, 0.01)
        center = (x, y, make.uniform(0.5, 1.1) * height)
        if make.chance(0.6):
            parts.append(printed_box(make, center, size, make.packages()))
        else:
            parts.append(cushion(center, size, make.plastic(), 0.7, 0.7, 10, 6))
    return standing("box", parts)


@generator
def coiled_cable(make: Maker) -> Furniture:
    """A charger with its cable in loops."""
    turns, radius = make.integer(2, 5), make.uniform(0.04, 0.1)
    angle = np.linspace(0, 2 * np.pi * turns, 12 * turns)
    wobble = radius * (1 + 0.25 * np.sin(1.7 * angle + make.uniform(0, 6)))
    path = np.stack([wobble * np.cos(angle), wobble * np.sin(angle), 0.006 + 0 * angle], 1)
    black = make.plastic(make.choice([0.04, 0.9]))
    plug = box((radius * 1.4, 0, 0.016), (0.06, 0.05, 0.032), black, 0.006)
    return standing("box", [tube(path, 0.005, black), plug])
