"""Tables and desks."""

from instok3d.rooms.colors import Number
from instok3d.rooms.materials import Maker, Material
from instok3d.rooms.objects.base import Furniture, Support, generator, legs, standing
from instok3d.rooms.primitives import Part, box, cylinder, lathe


def _round_table(make: Maker, diameter: Number, height: Number) -> Furniture:
    thickness = make.uniform(0.02, 0.06)
    top = make.furniture()
    under = make.other_furniture(top, 0.5)
    low = height - thickness
    parts = [cylinder((0, 0, low), diameter / 2, thickness, top, 36)]
    if make.chance(0.6):
        foot = diameter * 0.28
        profile = [(foot, 0), (foot, 0.03), (0.05, 0.08), (0.04, height * 0.5), (0.06, low)]
        parts.append(lathe(profile, under, 20))
    else:
        span = diameter * 0.75
        parts += legs(True, span, span, low, 0.022, under, 0.02, 0.06)
    reach = diameter * 0.33
    return standing("table", parts, [Support(-reach, -reach, reach, reach, height)])


def _frame(
    make: Maker, width: Number, depth: Number, height: Number, material: Material
) -> list[Part]:
    """What carries a rectangular top whose underside is at `height`."""
    kind = make.integer(0, 4)
    if kind == 0:
        return legs(False, width, depth, height, make.uniform(0.018, 0.04), material, 0.06)
    if kind == 1:
        radius, splay = make.uniform(0.018, 0.04), make.uniform(0, 0.04)
        return legs(True, width, depth, height, radius, material, 0.06, splay)
    if kind == 2:
        size = (0.05, depth * 0.85, height)
        ends = [
            box((side * (width / 2 - 0.1), 0, height / 2), size, material, 0.004)
            for side in (-1, 1)
        ]
        return [*ends, box((0, 0, height * 0.35), (width - 0.22, 0.04, 0.08), material)]
    apron = box((0, 0, height - 0.05), (width - 0.12, depth - 0.12, 0.08), material)
    return [*legs(False, width, depth, height, 0.025, material, 0.05), apron]


def _rectangular_table(
    make: Maker, name: str, width: Number, depth: Number, height: Number
) -> Furniture:
    thickness = make.uniform(0.02, 0.06)
    wood = make.furniture()
    under = wood if make.chance(0.5) else make.metal() if make.chance(0.5) else make.furniture()
    bevel = 0.006 if make.chance(0.7) else 0.02
    top = box((0, 0, height - thickness / 2), (width, depth, thickness), wood, bevel)
    parts = [top, *_frame(make, width, depth, height - thickness, under)]
    x, y = width / 2 - 0.06, depth / 2 - 0.06
    return standing(name, parts, [Support(-x, -y, x, y, height)])


@generator
def table(make: Maker) -> Furniture:
    """A dining table, round or rectangular."""
    height = make.uniform(0.7, 0.78)
    if make.chance(0.28):
        return _round_table(make, make.uniform(0.8, 1.25), height)
    width, depth = make.uniform(0.9, 1.8), make.uniform(0.7, 1.0)
    return _rectangular_table(make, "table", width, depth, height)


@generator
def coffee_table(make: Maker) -> Furniture:
    """A low table."""
    size = make.uniform(0.7, 1.2), make.uniform(0.45, 0.65), make.uniform(0.35, 0.48)
    return _rectangular_table(make, "coffee table", *size)


@generator
def side_table(make: Maker) -> Furniture:
    """A small table beside a seat."""
    size = make.uniform(0.35, 0.55), make.uniform(0.35, 0.5), make.uniform(0.45, 0.65)
    return _rectangular_table(make, "side table", *size)


def _pedestal(
    make: Maker, x: Number, size: tuple[Number, Number, Number], wood: Material
) -> list[Part]:
    """A block of drawers under a desk, with its front at -size[1] / 2."""
    width, depth, height = size
    parts = [box((x, 0.01, height / 2), size, wood, 0.004)]
    handle, count = make.metal(), make.integer(2, 5)
    front = make.other_furniture(wood, 0.5)
    for i in range(count):
        z, y = height * (i + 0.5) / count, -depth / 2
        parts.append(box((x, y, z), (width - 0.03, 0.03, height / count - 0.025), front, 0.004))
        parts.append(box((x, y - 0.022, z), (0.1, 0.016, 0.012), handle))
    return parts


@generator
def desk(make: Maker) -> Furniture:
    """A writing desk on legs or with a block of drawers."""
    width, depth, height = make.uniform(1.0, 1.7), make.uniform(0.55, 0.75), make.uniform(0.7, 0.77)
    wood = make.furniture()
    second, thickness = make.other_furniture(wood, 0.5), make.uniform(0.02, 0.045)
    low = height - thickness
    parts = [box((0, 0, height - thickness / 2), (width, depth, thickness), wood, 0.005)]
    side, block = make.choice([-1, 1]), make.uniform(0.32, 0.45)
    if make.chance(0.7):
        x = side * (width / 2 - block / 2 - 0.02)
        parts += _pedestal(make, x, (block, depth - 0.06, low), second)
        parts.append(
            box((-side * (width / 2 - 0.03), 0, low / 2), (0.04, depth - 0.06, low), second)
        )
    else:
        parts += legs(make.chance(0.5), width, depth, low, 0.022, second, 0.05)
    if make.chance(0.5):
        parts.append(
            box((0, depth / 2 - 0.03, height * 0.6), (width - 0.1, 0.02, height * 0.4), second)
        )
    x, y = width / 2 - 0.08, depth / 2 - 0.07
    return standing("desk", parts, [Support(-x, -y, x, y, height)])
