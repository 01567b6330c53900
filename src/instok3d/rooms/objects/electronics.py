"""Screens, keyboards, and other things with a plug."""

from instok3d.rooms import pictures
from instok3d.rooms.colors import Number
from instok3d.rooms.materials import Maker, Material
from instok3d.rooms.objects.base import Furniture, generator, standing
from instok3d.rooms.primitives import Part, box, cushion, quad, rot_x


def _screen(make: Maker, y: Number, z: Number, width: Number, height: Number) -> Part:
    """A screen that faces the front, centred at z."""
    corner = (-width / 2, y, z - height / 2)
    return quad(corner, (width, 0, 0), (0, 0, height), make.screen())


def _keys(make: Maker, corner: tuple[Number, Number, Number], width: Number, depth: Number) -> Part:
    material = Material("plastic", pictures.keyboard(make.rng))
    return quad(corner, (width, 0, 0), (0, depth, 0), material)


@generator
def monitor(make: Maker) -> Furniture:
    """A computer monitor on its foot."""
    width = make.uniform(0.45, 0.7)
    height, neck = width * make.uniform(0.55, 0.62), make.uniform(0.08, 0.16)
    case, z = make.plastic(make.uniform(0.03, 0.2)), neck + height / 2
    parts = [
        box((0, 0.03, 0.008), (0.24, 0.18, 0.016), case, 0.004),
        box((0, 0.05, neck / 2 + 0.05), (0.05, 0.03, neck + 0.1), case),
        box((0, 0.02, z), (width, 0.03, height), case, 0.006),
        _screen(make, 0.0035, z, width - 0.03, height - 0.03),
    ]
    return standing("monitor", parts)


@generator
def television(make: Maker) -> Furniture:
    """A television on a low foot."""
    width = make.uniform(0.8, 1.4)
    height, case = width * 0.58, make.plastic(0.04)
    z = 0.06 + height / 2
    parts = [
        box((0, 0.02, 0.01), (width * 0.4, 0.22, 0.02), case, 0.004),
        box((0, 0.04, 0.05), (0.08, 0.03, 0.1), case),
        box((0, 0.02, z), (width, 0.05, height), case, 0.008),
        _screen(make, -0.0065, z, width - 0.04, height - 0.04),
    ]
    return standing("television", parts)


@generator
def laptop(make: Maker) -> Furniture:
    """An open laptop."""
    width = make.uniform(0.3, 0.38)
    depth, case = width * 0.68, make.plastic(make.choice([0.1, 0.55, 0.75]))
    tilt = rot_x(-make.uniform(0.15, 0.45))
    lid = [box((0, 0, depth / 2), (width, 0.008, depth), case, 0.002)]
    lid.append(_screen(make, -0.005, depth / 2, width - 0.02, depth - 0.02))
    parts = [
        box((0, 0, 0.009), (width, depth, 0.018), case, 0.003),
        _keys(make, (-width * 0.44, -depth * 0.1, 0.0195), width * 0.88, depth * 0.52),
        *(part.moved(tilt, (0, depth / 2, 0.018)) for part in lid),
    ]
    return standing("laptop", parts)


@generator
def keyboard(make: Maker) -> Furniture:
    """A computer keyboard."""
    width, depth = make.uniform(0.36, 0.46), make.uniform(0.12, 0.16)
    case = make.plastic(make.uniform(0.05, 0.9))
    keys = _keys(make, (-width * 0.48, -depth * 0.45, 0.0212), width * 0.96, depth * 0.9)
    return standing("keyboard", [box((0, 0, 0.01), (width, depth, 0.02), case, 0.004), keys])


@generator
def printer(make: Maker) -> Furniture:
    """A printer with paper in its tray."""
    width, depth, height = (
        make.uniform(0.38, 0.5),
        make.uniform(0.32, 0.42),
        make.uniform(0.18, 0.32),
    )
    case, trim = make.plastic(make.choice([0.1, 0.8, 0.9])), make.plastic(0.2)
    paper = make.plain("paper", 0.95, 0.0)
    parts = [
        box((0, 0, height / 2), (width, depth, height), case, 0.015),
        box((0, -depth / 2, height * 0.35), (width * 0.7, 0.08, 0.02), trim),
        box((0, 0, height + 0.005), (width * 0.8, depth * 0.6, 0.02), trim, 0.004),
        box((0, 0.1, height + 0.06), (width * 0.55, 0.01, 0.12), paper),
    ]
    return standing("printer", parts)


@generator
def telephone(make: Maker) -> Furniture:
    """A desk telephone with its receiver."""
    case = make.plastic()
    parts = [
        box((0, 0, 0.03), (0.18, 0.2, 0.05), case, 0.012),
        cushion((-0.06, 0, 0.075), (0.05, 0.22, 0.045), case, 0.5, 0.5),
        _keys(make, (-0.02, -0.07, 0.0562), 0.09, 0.12),
    ]
    return standing("telephone", parts)
