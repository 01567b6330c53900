"""Lamps: on the floor, on tables, under the ceiling."""

from instok3d.rooms.colors import Number
from instok3d.rooms.materials import Maker, Material
from instok3d.rooms.objects.base import Furniture, generator, hanging, standing
from instok3d.rooms.primitives import Part, ball, cylinder, lathe, rod


def _shade(
    low: Number, wide: Number, high: Number, narrow: Number, material: Material
) -> list[Part]:
    """An open cone, with its inside."""
    outside = [(wide, low), (narrow, high)]
    inside = [(narrow - 0.003, high), (wide - 0.003, low)]
    return [lathe(outside, material, 24), lathe(inside, material, 24)]


@generator
def floor_lamp(make: Maker) -> Furniture:
    """A lamp on a pole."""
    height, metal, cloth = make.uniform(1.35, 1.75), make.metal(), make.shade(0.6, 2.2, 0.75)
    narrow, wide, tall = make.uniform(0.1, 0.16), make.uniform(0.15, 0.24), make.uniform(0.18, 0.3)
    parts = [
        cylinder((0, 0, 0), make.uniform(0.12, 0.17), 0.025, metal, 24),
        cylinder((0, 0, 0.02), 0.012, height - 0.1, metal, 8),
        *_shade(height - tall, wide, height, narrow, cloth),
    ]
    return standing("lamp", parts)


@generator
def table_lamp(make: Maker) -> Furniture:
    """A lamp with a turned foot."""
    height = make.uniform(0.32, 0.55)
    foot = make.ceramic() if make.chance(0.5) else make.metal()
    cloth, wide = make.shade(0.6, 2.2, 0.7), make.uniform(0.09, 0.15)
    narrow, tall, base = (
        wide * make.uniform(0.5, 1),
        height * make.uniform(0.35, 0.5),
        make.uniform(0.04, 0.08),
    )
    profile = [
        (base, 0), (base, 0.02), (base * make.uniform(0.2, 1), height * 0.15),
        (base * make.uniform(0.3, 1.2), height * 0.35), (0.012, height - tall),
        (0.012, height - tall * 0.5),
    ]  # fmt: skip
    shade = _shade(height - tall, wide, height, narrow, cloth)
    return standing("lamp", [lathe(profile, foot, 18, smooth=True), *shade])


@generator
def ceiling_lamp(make: Maker) -> Furniture:
    """A globe or a cone on a cable, or a flat disc."""
    cable, kind, radius = make.uniform(0.1, 0.4), make.integer(0, 3), make.uniform(0.1, 0.22)
    glow = make.glow(2.5, 6)
    metal = make.metal()
    if kind == 2:
        disc = cylinder((0, 0, -0.08), radius * 1.3, 0.08, glow, 28)
        return hanging("ceiling lamp", [disc])
    parts = [rod((0, 0, -cable), (0, 0, 0), 0.006, metal, 6)]
    if kind == 0:
        parts.append(ball((0, 0, -cable - radius), radius, glow, 20, 12))
    else:
        radius = min(radius, 0.2)
        parts += _shade(-cable - radius, radius * 1.5, -cable, radius * 0.4, metal)
        parts.append(ball((0, 0, -cable - radius * 0.7), radius / 2, glow, 14, 8))
    return hanging("ceiling lamp", parts)
