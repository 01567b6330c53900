"""What lies and stands about on the floors of lived-in rooms."""

import numpy as np

from instok3d.rooms.materials import Maker
from instok3d.rooms.objects.base import Furniture, generator, standing
from instok3d.rooms.objects.printed import printed_box, sheets
from instok3d.rooms.primitives import box, cushion, rod, rot_z, tube


@generator
def shoes(make: Maker) -> Furniture:
    """A pair of shoes."""
    length, upper, sole, parts = make.uniform(0.24, 0.31), make.fabric(), make.plastic(), []
    tall = make.uniform(0.05, 0.1) if make.chance(0.8) else 0.22
    for side in (-1, 1):
        turn = rot_z(make.uniform(-0.35, 0.35))
        place = (side * 0.08, make.uniform(-0.06, 0.06), 0)
        pieces = [
            cushion((0, 0, 0.015), (0.1, length, 0.03), sole, 0.3, 0.7, 14, 6),
            cushion((0, 0, 0.05), (0.09, length * 0.96, 0.07), upper, 0.6, 0.8, 14, 6),
            cushion((0, 0.25 * length, 0.04 + tall / 2), (0.085, length * 0.4, tall), upper),
        ]
        parts += [piece.moved(turn, place) for piece in pieces]
    return standing("shoes", parts)


@generator
def carrier_bag(make: Maker) -> Furniture:
    """A paper or shopping bag with handles."""
    width, depth, height = make.uniform(0.22, 0.4), make.uniform(0.1, 0.2), make.uniform(0.25, 0.42)
    if make.chance(0.5):
        body = printed_box(make, (0, 0, height / 2), (width, depth, height), make.packages())
    else:
        size = (width, depth * 1.3, height)
        body = cushion((0, 0, height / 2), size, make.fabric(), 0.4, 0.4, 16, 8)
    angle = np.linspace(0, np.pi, 9)
    arch = np.stack(
        [width * 0.25 * np.cos(angle), 0 * angle, height - 0.01 + 0.1 * np.sin(angle)], 1
    )
    handles = [
        tube(arch, 0.007, make.plastic(0.1)).moved(offset=(0, s * depth * 0.35, 0)) for s in (-1, 1)
    ]
    return standing("bag", [body, *handles])


@generator
def box_pile(make: Maker) -> Furniture:
    """Two to four printed or plain boxes on each other."""
    covers, z, parts = make.packages(), 0.0, []
    for _ in range(make.integer(2, 5)):
        size = make.uniform(0.2, 0.42), make.uniform(0.2, 0.34), make.uniform(0.08, 0.26)
        block = printed_box(make, (0, 0, 0), size, covers)
        if make.chance(0.4):
            block = box((0, 0, 0), size, make.plastic())
        offset = make.uniform(-0.03, 0.03), make.uniform(-0.03, 0.03), z + size[2] / 2
        parts.append(block.moved(rot_z(make.uniform(-0.2, 0.2)), offset))
        z += size[2]
    return standing("box", parts)


@generator
def crate(make: Maker) -> Furniture:
    """An open crate full of bottles, packets or papers."""
    width, depth, height = make.uniform(0.3, 0.42), make.uniform(0.25, 0.32), make.uniform(0.2, 0.3)
    wall, parts = make.plastic(), []
    parts.append(box((0, 0, 0.01), (width, depth, 0.02), wall))
    for s in (-1, 1):
        parts.append(box((s * (width / 2 - 0.008), 0, height / 2), (0.016, depth, height), wall))
        parts.append(box((0, s * (depth / 2 - 0.008), height / 2), (width, 0.016, height), wall))
    for i in range(3):
        for j in range(2):
            center = np.array([(i - 1) * width * 0.3, (j - 0.5) * depth * 0.42, height * 0.62])
            size = np.array([width * 0.24, depth * 0.36, height]) * make.uniform(0.7, 1.1)
            parts.append(printed_box(make, center, size, make.packages()))
    return standing("box", parts)


@generator
def floor_papers(make: Maker) -> Furniture:
    """Papers scattered over the floor."""
    return standing("paper", sheets(make, make.integer(2, 9), (0.21, 0.297), 0.25))


@generator
def broom(make: Maker) -> Furniture:
    """A broom, umbrella or roll that stands against something."""
    height, lean = make.uniform(0.8, 1.5), make.uniform(0.08, 0.2)
    stick = rod((0, 0, 0.04), (0, lean, height), make.uniform(0.011, 0.03), make.plastic())
    foot = box((0, 0, 0.04), (make.uniform(0.06, 0.3), 0.06, 0.08), make.plastic(), 0.01)
    return standing("box", [stick, foot])
