"""Sockets, switches and cables: where they run, and to which instances they belong."""

import numpy as np

from instok3d.rooms.materials import Maker
from instok3d.rooms.objects import REGISTRY
from instok3d.rooms.objects.base import fixed
from instok3d.rooms.plan import Placed, Plan
from instok3d.rooms.primitives import box, quad
from instok3d.rooms.shell import footprint_walls
from instok3d.rooms.wiring import CABLE_M, slack, wire


def empty_room(make: Maker) -> Plan:
    """Four walls and a floor of 3 x 4 metres."""
    plan, paint = Plan(3.0, 4.0, 2.5), make.plain("paint", 0.5)
    plan.walls = footprint_walls(3.0, 4.0, None)
    floor = quad((0, 0, 0), (3, 0, 0), (0, 4, 0), paint, False)
    plan.add(Placed(fixed("floor", [floor]), "shell", 0, 0, 0, 0))
    for wall in plan.walls:
        body = fixed("wall", [quad((0, 0, 0), (wall.length, 0, 0), (0, 0, 2.5), paint, False)])
        x, y = wall.start
        plan.add(Placed(body, "shell", float(x), float(y), 0.0, wall.angle_rad))
    return plan


def test_a_path_keeps_its_ends_and_stays_between_its_knots():
    knots = [(0, 0, 0), (1, 0, 0), (1, 2, 0)]
    path = slack(knots)
    np.testing.assert_allclose(path[[0, -1]], [knots[0], knots[-1]])
    assert (path >= 0).all()
    assert (path <= [1, 2, 0]).all()
    assert (np.linalg.norm(np.diff(path, axis=0), axis=1) > 0).all()


def test_sockets_and_cables_belong_to_walls_and_floor():
    make = Maker(np.random.default_rng(0))
    plan = empty_room(make)
    before = [p.furniture for p in plan.placed]
    wire(plan, make, 20)
    after = [p.furniture for p in plan.placed]
    assert [f.size for f in after] == [f.size for f in before]
    grown = [len(a.parts) - len(b.parts) for a, b in zip(after, before, strict=True)]
    assert grown[0] > 2  # cables on the floor
    assert sum(grown[1:]) > 20
    for part in after[0].parts[1:]:
        assert part.vertices[:, 2].min() > -1e-6
        assert part.vertices[:, 2].max() < 2.1 * CABLE_M
    for wall in after[1:]:
        for part in wall.parts[1:]:
            assert -0.06 < part.vertices[:, 1].min() <= part.vertices[:, 1].max() < 1e-6


def test_nothing_is_wired_where_furniture_covers_the_walls():
    make = Maker(np.random.default_rng(0))
    plan = empty_room(make)
    wood = make.plain("wood", 0.5)
    for wall in plan.walls:
        block = fixed("wardrobe", [box((0, 0, 1.25), (wall.length, 0.5, 2.5), wood)])
        region = wall.box(wall.length / 2, wall.length, 0.5, 0.0, 2.5)
        plan.add(Placed(block, "wardrobe", region.x, region.y, 0.0, wall.angle_rad), region)
    before = [len(p.furniture.parts) for p in plan.placed]
    wire(plan, make, 20)
    assert [len(p.furniture.parts) for p in plan.placed] == before


def test_a_cable_runs_over_the_back_edge_of_a_desk():
    for seed in range(8):
        make = Maker(np.random.default_rng(seed))
        plan, desk = empty_room(make), REGISTRY["desk"](make)
        plan.add(Placed(desk, "desk", 1.5, 2.0, 0.0, 0.0))
        wire(plan, make, 0)
        for cable in plan.placed[-1].furniture.parts[len(desk.parts) :]:
            low, high = cable.vertices.min(0), cable.vertices.max(0)
            assert desk.size[2] < high[2] < desk.size[2] + 0.03
            assert low[2] < 0.5 * desk.size[2]
            assert desk.size[1] / 2 - 0.01 < high[1] < desk.size[1] / 2 + 0.03
            return
    raise AssertionError("no desk got a cable")
