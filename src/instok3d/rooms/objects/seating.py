"""Seats: chairs, stools, benches, sofas, armchairs, ottomans."""

import numpy as np

from instok3d.rooms.colors import Number
from instok3d.rooms.materials import Maker, Material
from instok3d.rooms.objects.base import Furniture, Support, generator, legs, standing
from instok3d.rooms.primitives import Part, ball, box, cushion, cylinder, rod, rot_x


def _slats(make: Maker, width: Number, height: Number, wood: Material) -> list[Part]:
    count = make.integer(3, 7)
    xs = np.linspace(-width / 2 + 0.03, width / 2 - 0.03, count)
    bars = [box((x, 0, height / 2), (0.02, 0.02, height), wood) for x in xs]
    return [*bars, box((0, 0, height), (width, 0.025, make.uniform(0.04, 0.09)), wood, 0.005)]


def _ladder(make: Maker, width: Number, height: Number, wood: Material) -> list[Part]:
    count = make.integer(2, 4)
    posts = [
        box((side * (width / 2 - 0.02), 0, height / 2), (0.03, 0.03, height), wood)
        for side in (-1, 1)
    ]
    rungs = [
        box(
            (0, 0, height * (i + 1) / count - 0.03),
            (width - 0.04, 0.018, height / count * 0.45),
            wood,
            0.004,
        )
        for i in range(count)
    ]
    return posts + rungs


def _chair_back(
    make: Maker, width: Number, height: Number, wood: Material, seat: Material
) -> list[Part]:
    """An upright back over the origin."""
    kind, thickness = make.integer(0, 4), make.uniform(0.015, 0.045)
    if kind == 0:
        return [box((0, 0, height / 2 + 0.02), (width, thickness, height), seat, 0.01)]
    if kind == 1:
        return _slats(make, width, height, wood)
    if kind == 2:
        return _ladder(make, width, height, wood)
    size = (width, max(thickness, 0.04), height)
    return [cushion((0, 0, height / 2 + 0.02), size, seat, 0.4, 0.4, 16, 10)]


@generator
def chair(make: Maker) -> Furniture:
    """A dining chair, or sometimes an office chair."""
    if make.chance(0.22):
        return office_chair(make)
    width, depth = make.uniform(0.38, 0.5), make.uniform(0.38, 0.5)
    seat_height, back_height = make.uniform(0.42, 0.48), make.uniform(0.3, 0.55)
    thickness = make.uniform(0.02, 0.06)
    wood = make.furniture()
    seat = wood if make.chance(0.4) else make.fabric()
    round_legs = make.chance(0.5)
    splay = make.uniform(0, 0.03) if round_legs else 0.0
    leg_radius = make.uniform(0.012, 0.025)
    parts = legs(round_legs, width, depth, seat_height, leg_radius, wood, 0.035, splay)
    middle = (0, 0, seat_height + thickness / 2)
    if make.chance(0.5):
        parts.append(box(middle, (width, depth, thickness), seat, 0.01))
    else:
        parts.append(cushion(middle, (width, depth, thickness * 1.3), seat, 0.5, 0.3, 16, 8))
    tilt = rot_x(-make.uniform(0.05, 0.22))
    foot = (0, depth / 2 - 0.03, seat_height + thickness - 0.01)
    back = _chair_back(make, width, back_height, wood, seat)
    parts += [part.moved(tilt, foot) for part in back]
    if make.chance(0.2):
        for side in (-1, 1):
            x = side * width / 2
            rest = (0.035, depth * 0.8, 0.025)
            parts.append(box((x, -0.02, seat_height + 0.2), rest, wood, 0.005))
            parts.append(box((x, -depth * 0.35, seat_height + 0.1), (0.025, 0.025, 0.2), wood))
    return standing("chair", parts)


def office_chair(make: Maker) -> Furniture:
    """A swivel chair on five castors."""
    frame, cloth = make.plastic(make.uniform(0.05, 0.3)), make.fabric()
    width, seat_height = make.uniform(0.45, 0.52), make.uniform(0.42, 0.5)
    back_height = make.uniform(0.4, 0.65)
    parts = [cylinder((0, 0, 0.08), 0.03, seat_height - 0.08, frame)]
    for angle in 2 * np.pi * np.arange(5) / 5:
        end = (0.28 * np.cos(angle), 0.28 * np.sin(angle), 0.05)
        parts.append(rod((0, 0, 0.1), end, 0.018, frame, 6))
        parts.append(ball((end[0], end[1], 0.03), 0.03, frame, 8, 6))
    parts.append(cushion((0, 0, seat_height + 0.03), (width, width, 0.1), cloth, 0.5, 0.4))
    back = cushion((0, 0, back_height / 2), (width * 0.92, 0.08, back_height), cloth, 0.4, 0.5)
    parts.append(back.moved(rot_x(-0.15), (0, width / 2 - 0.02, seat_height + 0.08)))
    if make.chance(0.6):
        for side in (-1, 1):
            x = side * (width / 2 + 0.02)
            parts.append(box((x, 0, seat_height + 0.22), (0.06, 0.26, 0.03), frame, 0.01))
            parts.append(box((x, 0.04, seat_height + 0.12), (0.03, 0.04, 0.2), frame))
    return standing("chair", parts)


@generator
def stool(make: Maker) -> Furniture:
    """A round or square stool, from low to bar height."""
    width, height, thickness = (
        make.uniform(0.3, 0.42),
        make.uniform(0.42, 0.75),
        make.uniform(0.03, 0.09),
    )
    wood = make.furniture()
    seat = wood if make.chance(0.5) else make.fabric()
    parts = legs(True, width, width, height, make.uniform(0.012, 0.02), wood, 0.05, 0.03)
    if make.chance(0.6):
        parts.append(cylinder((0, 0, height), width / 2, thickness, seat, 24))
    else:
        parts.append(box((0, 0, height + thickness / 2), (width, width, thickness), seat, 0.015))
    return standing("stool", parts)


@generator
def bench(make: Maker) -> Furniture:
    """A bench without a back."""
    width, depth, height = make.uniform(0.9, 1.4), make.uniform(0.32, 0.45), make.uniform(0.4, 0.48)
    wood = make.wood()
    seat = wood if make.chance(0.5) else make.fabric()
    top = box((0, 0, height - 0.025), (width, depth, make.uniform(0.04, 0.1)), seat, 0.012)
    return standing("bench", [*legs(False, width, depth, height - 0.05, 0.025, wood, 0.05), top])


def _upholstered(make: Maker, name: str, width: Number, pillow_support: bool) -> Furniture:
    depth, seat, back = make.uniform(0.78, 1.0), make.uniform(0.38, 0.46), make.uniform(0.35, 0.5)
    arm, arm_height = make.uniform(0.1, 0.24), make.uniform(0.12, 0.26)
    cover = make.upholstery()
    feet, edge, thick = make.uniform(0.03, 0.15), make.uniform(0.01, 0.06), make.uniform(0.1, 0.18)
    back_depth = make.uniform(0.14, 0.24)
    parts = legs(make.chance(0.5), width, depth, feet + 0.02, 0.025, make.furniture(), 0.08)
    base_height = seat - thick - feet
    parts.append(box((0, 0, feet + base_height / 2), (width, depth, base_height), cover, edge / 2))
    back_size = (width, back_depth, seat + back - feet)
    parts.append(
        box((0, depth / 2 - back_depth / 2, feet + back_size[2] / 2), back_size, cover, edge)
    )
    arm_size = (arm, depth, seat + arm_height - feet)
    for side in (-1, 1):
        center = (side * (width / 2 - arm / 2), 0, feet + arm_size[2] / 2)
        parts.append(box(center, arm_size, cover, edge))
    inner = width - 2 * arm
    count = max(1, round(inner / make.uniform(0.55, 0.85)))
    each = inner / count
    cloth = cover if make.chance(0.8) else make.fabric()
    for i in range(count):
        x = -inner / 2 + each * (i + 0.5)
        seat_size = (each * 0.99, depth - back_depth, thick * 1.15)
        parts.append(
            cushion((x, -back_depth / 2, seat - thick / 2), seat_size, cloth, 0.3, 0.18, 20, 8)
        )
        upright = cushion((0, 0, 0), (each * 0.97, 0.17, back * 0.95), cloth, 0.35, 0.3, 16, 10)
        place = (x, depth / 2 - back_depth - 0.06, seat + back * 0.45)
        parts.append(upright.moved(rot_x(-0.15), place))
    top = seat + thick * 0.075
    front = -depth / 2 + 0.12
    supports = [Support(-inner / 2 + 0.02, front, inner / 2 - 0.02, front + 0.3, top)]
    return standing(name, parts, supports if pillow_support else [])


@generator
def sofa(make: Maker) -> Furniture:
    """A sofa with one to three seat cushions; its support is for pillows."""
    return _upholstered(make, "sofa", make.uniform(1.4, 2.3), pillow_support=True)


@generator
def armchair(make: Maker) -> Furniture:
    """An upholstered chair with arms; nothing is put on it."""
    return _upholstered(make, "armchair", make.uniform(0.75, 0.98), pillow_support=False)


@generator
def ottoman(make: Maker) -> Furniture:
    """A round or square upholstered footstool."""
    width, depth, height = make.uniform(0.4, 0.75), make.uniform(0.4, 0.6), make.uniform(0.32, 0.45)
    cloth = make.fabric()
    if make.chance(0.4):
        return standing("ottoman", [cylinder((0, 0, 0), width / 2, height, cloth, 28)])
    body = cushion((0, 0, height / 2), (width, depth, height), cloth, 0.25, 0.25)
    return standing("ottoman", [body])
