"""Storage: shelves, cabinets and their kin, counters, the piano."""

import numpy as np

from instok3d.rooms import pictures
from instok3d.rooms.colors import Number
from instok3d.rooms.materials import Maker, Material
from instok3d.rooms.objects.base import (
    Furniture,
    Support,
    generator,
    legs,
    standing,
    wall_mounted,
)
from instok3d.rooms.primitives import Part, ball, box, cylinder, lathe, quad, rod


def books_row(
    make: Maker,
    left: Number,
    width: Number,
    depth: Number,
    bottom: Number,
    height: Number,
    y: Number,
) -> Part:
    """A row of books from x = left, with its bottom at z = bottom."""
    row = box((left + width / 2, y, bottom + height / 2), (width, depth, height), make.books())
    u = (row.vertices[:, 0] - left) / 0.35
    return row.mapped(np.stack([u, (row.vertices[:, 2] - bottom) / height], 1))


def _shelf_contents(
    make: Maker, left: Number, right: Number, bottom: Number, height: Number, depth: Number
) -> list[Part]:
    """Books, vases, boxes and gaps from left to right."""
    parts, x = [], left
    while x < right - 0.06:
        kind = make.rng.random()
        if kind < 0.6:
            width = min(make.uniform(0.12, 0.4), right - x)
            tall = make.uniform(0.5, 0.8) * height
            y, deep = make.uniform(-0.03, 0.02), depth * make.uniform(0.5, 0.75)
            parts.append(books_row(make, x, width, deep, bottom, tall, y))
            x += width + 0.01
        elif kind < 0.75:
            s = min(make.uniform(0.06, 0.15), right - x, height * 0.7)
            profile = [
                (1e-4, 0), (s * 0.4, 0), (s * 0.5, s * 0.6), (s * 0.25, s), (s * 0.3, s * 1.3)
            ]  # fmt: skip
            parts.append(lathe(profile, make.ceramic(), 14, (x + s / 2, 0, bottom), smooth=True))
            x += s + 0.03
        elif kind < 0.87:
            s = min(make.uniform(0.12, 0.25), right - x)
            size = (s, depth * 0.7, s * 0.7)
            parts.append(box((x + s / 2, 0, bottom + s * 0.35), size, make.plastic(), 0.006))
            x += s + 0.02
        else:
            x += make.uniform(0.08, 0.3)
    return parts


@generator
def bookshelf(make: Maker) -> Furniture:
    """An open shelf with books and things."""
    width, depth, height = make.uniform(0.6, 1.3), make.uniform(0.26, 0.36), make.uniform(1.0, 2.1)
    wood, board = make.furniture(), make.uniform(0.018, 0.035)
    count = max(2, int(height / make.uniform(0.3, 0.42)))
    parts = [
        box((side * (width / 2 - board / 2), 0, height / 2), (board, depth, height), wood)
        for side in (-1, 1)
    ]
    if make.chance(0.75):
        parts.append(box((0, depth / 2 - 0.006, height / 2), (width, 0.012, height), wood))
    cell, inside = (height - board) / count, width / 2 - board
    for i in range(count + 1):
        parts.append(box((0, 0, board / 2 + cell * i), (2 * inside, depth, board), wood))
    for i in range(count):
        bottom = board + cell * i
        parts += _shelf_contents(make, 0.01 - inside, inside - 0.005, bottom, cell - board, depth)
    x, y = width / 2 - 0.08, depth / 2 - 0.08
    return standing("bookshelf", parts, [Support(-x, -y, x, y, height)] if height < 1.5 else [])


def _handle(x: Number, y: Number, z: Number, door: bool, knob: bool, metal: Material) -> Part:
    if door:
        return box((x, y, z), (0.014, 0.02, 0.12), metal)
    if knob:
        return ball((x, y, z), 0.015, metal, 8, 6)
    return box((x, y, z), (0.11, 0.02, 0.014), metal)


def carcass(make: Maker, width: Number, depth: Number, height: Number) -> list[Part]:
    """A closed body with doors or drawers in front, on feet or on the floor."""
    wood = make.furniture()
    front, metal = make.other_furniture(wood, 0.6), make.metal()
    feet, knob = make.uniform(0, 0.15), make.chance(0.5)
    if feet < 0.03:
        feet = 0.0
    body = height - feet
    parts = [box((0, 0, feet + body / 2), (width, depth, body), wood, 0.004)]
    if feet:
        parts += legs(make.chance(0.5), width, depth, feet, 0.02, make.furniture(), 0.05)
    columns = max(1, round(width / make.uniform(0.35, 0.6)))
    doors = make.chance(0.5)
    rows = 1 if doors else max(1, int(body / make.uniform(0.22, 0.4)))
    cell_width, cell_height, y = width / columns, body / rows, -depth / 2
    for i in range(columns):
        for j in range(rows):
            x, z = -width / 2 + cell_width * (i + 0.5), feet + cell_height * (j + 0.5)
            size = (cell_width - 0.02, 0.018, cell_height - 0.02)
            parts.append(box((x, y - 0.006, z), size, front, 0.004))
            if doors:
                x += (cell_width / 2 - 0.06) * (1 if i % 2 == 0 else -1)
                z += min(cell_height * 0.2, 0.3)
            parts.append(_handle(x, y - 0.025, z, doors, knob, metal))
    return parts


def _cabinet(make: Maker, name: str, width: Number, depth: Number, height: Number) -> Furniture:
    x, y = width / 2 - 0.06, depth / 2 - 0.05
    parts = carcass(make, width, depth, height)
    return standing(name, parts, [Support(-x, -y, x, y, height)] if height < 1.5 else [])


@generator
def cabinet(make: Maker) -> Furniture:
    """A sideboard."""
    size = make.uniform(0.6, 1.4), make.uniform(0.35, 0.5), make.uniform(0.7, 1.2)
    return _cabinet(make, "cabinet", *size)


@generator
def dresser(make: Maker) -> Furniture:
    """A chest of drawers."""
    size = make.uniform(0.8, 1.4), make.uniform(0.4, 0.5), make.uniform(0.7, 1.0)
    return _cabinet(make, "dresser", *size)


@generator
def nightstand(make: Maker) -> Furniture:
    """A small cabinet beside the bed."""
    size = make.uniform(0.38, 0.55), make.uniform(0.35, 0.42), make.uniform(0.42, 0.6)
    return _cabinet(make, "nightstand", *size)


@generator
def wardrobe(make: Maker) -> Furniture:
    """A tall cabinet."""
    size = make.uniform(0.9, 1.8), make.uniform(0.5, 0.62), make.uniform(1.8, 2.15)
    return _cabinet(make, "wardrobe", *size)


@generator
def tv_stand(make: Maker) -> Furniture:
    """A low wide cabinet."""
    size = make.uniform(1.1, 1.8), make.uniform(0.35, 0.45), make.uniform(0.4, 0.6)
    return _cabinet(make, "tv stand", *size)


def _kitchen_basin(make: Maker, x: Number, z: Number) -> list[Part]:
    steel = make.metal()
    return [
        box((x, -0.02, z + 0.004), (0.5, 0.38, 0.01), steel, 0.003),
        box((x, -0.02, z + 0.0095), (0.42, 0.3, 0.003), make.plain("metal", 0.12, 0.0)),
        rod((x, 0.2, z), (x, 0.2, z + 0.22), 0.012, steel),
        rod((x, 0.2, z + 0.22), (x, 0.05, z + 0.2), 0.011, steel),
    ]


@generator
def counter(make: Maker) -> Furniture:
    """A kitchen counter, with a basin or hot plates as it comes."""
    width, depth, height = (
        make.uniform(1.4, 2.4),
        make.uniform(0.58, 0.65),
        make.uniform(0.86, 0.94),
    )
    parts = carcass(make, width, depth - 0.04, height - 0.04)
    top = (width + 0.02, depth, 0.04)
    parts.append(box((0, -0.01, height - 0.02), top, make.stone(), 0.005))
    left, right = -width / 2 + 0.1, width / 2 - 0.1
    if make.chance(0.6):  # the basin at one end, things stand at the other
        parts += _kitchen_basin(make, left + 0.25, height)
        left += 0.55
    if make.chance(0.5):
        metal = make.metal()
        x = right - 0.22
        parts += [
            cylinder((x + dx, dy, height), 0.09, 0.012, metal)
            for dx in (-0.13, 0.13)
            for dy in (-0.1, 0.12)
        ]
        right -= 0.47
    y = depth / 2 - 0.1
    supports = [Support(left, -y, right, y, height)] if right - left > 0.2 else []
    return standing("counter", parts, supports)


@generator
def wall_shelf(make: Maker) -> Furniture:
    """A board on the wall with books and jars."""
    width, depth = make.uniform(0.6, 1.2), make.uniform(0.18, 0.26)
    parts = [box((0, -depth / 2, 0), (width, depth, 0.025), make.furniture(), 0.003)]
    x = -width / 2 + 0.05
    while x < width / 2 - 0.12:
        span = min(make.uniform(0.08, 0.3), width / 2 - x - 0.02)
        height = make.uniform(0.16, 0.26)
        if make.chance(0.5):
            parts.append(books_row(make, x, span, depth * 0.7, 0.0125, height, -depth / 2))
        elif make.chance(0.5):
            place = (x + 0.05, -depth / 2, 0.0125)
            parts.append(cylinder(place, 0.04, height * 0.7, make.ceramic()))
        x += span + 0.03
    return wall_mounted("shelf", parts)


@generator
def piano(make: Maker) -> Furniture:
    """An upright piano."""
    width, depth, height = make.uniform(1.35, 1.5), make.uniform(0.5, 0.6), make.uniform(1.05, 1.25)
    wood = make.wood() if make.chance(0.5) else make.plastic(0.04)
    parts = [
        box((0, depth * 0.15, height / 2), (width, depth * 0.6, height), wood, 0.01),
        box((0, -depth * 0.25, 0.66), (width, depth * 0.5, 0.12), wood, 0.006),
    ]
    for side in (-1, 1):
        parts.append(box((side * (width / 2 - 0.04), -depth * 0.42, 0.3), (0.06, 0.06, 0.6), wood))
    keys = Material("plastic", pictures.piano_keys(make.rng))
    corner = (-width * 0.47, -depth * 0.48, 0.7205)
    parts.append(quad(corner, (width * 0.94, 0, 0), (0, depth * 0.24, 0), keys))
    top = Support(-width / 2 + 0.1, 0.02, width / 2 - 0.1, depth * 0.35, height)
    return standing("piano", parts, [top])
