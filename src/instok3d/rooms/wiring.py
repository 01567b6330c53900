"""Sockets, switches and cables: parts of the walls, floor and furniture that they are on."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from instok3d.rooms.materials import Maker, Material
from instok3d.rooms.plan import Plan
from instok3d.rooms.primitives import Part, Point, box, tube

CABLE_M = 0.005
"""Radius of a cable."""

WITH_CABLES = ("desk", "tv stand", "cabinet", "counter", "table", "nightstand", "dresser")
"""Furniture over whose back edge cables run."""


def slack(knots: Sequence[Point], points: int = 28) -> Float[np.ndarray, "point 3"]:
    """A path from the first knot to the last, rounded at the knots between."""
    corners = np.asarray(knots, float)
    steps = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.linspace(0, along[-1], points)
    path = np.stack([np.interp(wanted, along, corners[:, i]) for i in range(3)], 1)
    for _ in range(3):
        path[1:-1] = (path[:-2] + path[1:-1] + path[2:]) / 3
    return path


def wire(plan: Plan, make: Maker, sockets: int) -> None:
    """Put sockets and switches on walls, some with a cable, and cables on furniture.

    The parts join the instances that are there; the sizes of these stay what they were.
    """
    plate, black = make.plastic(make.uniform(0.75, 0.95)), make.dark()
    cables = [black, plate]
    for _ in range(sockets):
        _socket(plan, make, plate, cables)
    for index, placed in enumerate(plan.placed):
        if placed.furniture.name in WITH_CABLES and make.chance(0.5):
            _add(plan, index, [_over_the_edge(make, plan, index, make.choice(cables))])


def _add(plan: Plan, index: int, parts: Sequence[Part]) -> None:
    placed = plan.placed[index]
    furniture = replace(placed.furniture, parts=(*placed.furniture.parts, *parts))
    plan.placed[index] = replace(placed, furniture=furniture)


def _socket(plan: Plan, make: Maker, plate: Material, cables: Sequence[Material]) -> None:
    """A switch at hand height, or a socket above the floor from which a cable may run."""
    number = make.integer(0, len(plan.walls))
    wall, switch = plan.walls[number], make.chance(0.3)
    along, z = make.uniform(0.1, wall.length - 0.1), make.choice([0.3, 0.35, 1.15])
    z = 1.05 if switch else z
    width = 0.08 if switch else make.choice([0.08, 0.15])
    if not plan.fits(wall.box(along, width, 0.012, z - 0.04, z + 0.04)):
        return
    hole = (width * 0.55, 0.004, 0.03 if switch else 0.035)
    parts = [
        box((along, -0.006, z), (width, 0.012, 0.08), plate, 0.002),
        box((along, -0.013, z), hole, plate if switch else cables[0]),
    ]
    walls = [i for i, p in enumerate(plan.placed) if p.furniture.name == "wall"]
    if not switch and make.chance(0.6):
        cable, out = make.choice(cables), make.uniform(0.15, 0.9)
        foot, end = along + make.uniform(-0.3, 0.3), along + make.uniform(-0.8, 0.8)
        down = [(along, -0.02, z), (along, -0.03, z - 0.05), (foot, -0.012, 0.08), (foot, -0.03, 0)]
        parts.append(box((along, -0.025, z), (0.035, 0.03, 0.035), cable))
        parts.append(tube(slack(down), CABLE_M, cable))
        run = [(foot, -0.03), (0.5 * (foot + end), -0.1), (end, -out)]
        floor = [np.append(wall.point(x, y), CABLE_M) for x, y in run]
        names = [p.furniture.name for p in plan.placed]
        _add(plan, names.index("floor"), [tube(slack(floor), CABLE_M, cable)])
    _add(plan, walls[number], parts)


def _over_the_edge(make: Maker, plan: Plan, index: int, cable: Material) -> Part:
    """A cable that lies on a top, runs over its back edge and hangs down behind."""
    furniture = plan.placed[index].furniture
    width, depth, height = furniture.size
    x, back = make.uniform(-0.35, 0.35) * width, depth / 2 + CABLE_M
    aside, top = x + make.uniform(-0.2, 0.2), height + CABLE_M
    low = make.uniform(0.02, 0.4) * height
    knots = [
        (aside, make.uniform(-0.2, 0.2) * depth, top), (x, 0.3 * depth, top), (x, back, top),
        (x, back, 0.7 * height), (x + make.uniform(-0.1, 0.1), back, low),
    ]  # fmt: skip
    return tube(slack(knots), CABLE_M, cable)
