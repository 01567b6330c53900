"""Solids that carry prints: boxes, sheets and bands mapped onto one cell of a sheet of prints."""

import numpy as np

from instok3d.rooms.colors import Number
from instok3d.rooms.materials import Maker, Material
from instok3d.rooms.primitives import Part, Point, box, lathe, quad, rot_z
from instok3d.rooms.prints import CELLS


def on_cell(make: Maker, part: Part, across: np.ndarray, up: np.ndarray) -> Part:
    """The part with one cell of its sheet spread over `across` and `up`, which run from 0 to 1."""
    corner = np.array([make.integer(0, CELLS), make.integer(0, CELLS)])
    inner = 0.04 + 0.92 * np.stack([across, up], 1)  # clear of the neighbours when seen small
    return part.mapped((corner + inner) / CELLS * part.material.tile_m)


def printed_box(make: Maker, center: Point, size: Point, material: Material) -> Part:
    """A box with the same print on all sides."""
    part = box(center, size, material)
    unit = (part.vertices - np.asarray(center, float)) / np.asarray(size, float) + 0.5
    axis = np.abs(part.normals).argmax(1)
    across = np.where(axis == 0, unit[:, 1], unit[:, 0])
    return on_cell(make, part, across, np.where(axis == 2, unit[:, 1], unit[:, 2]))


def printed_quad(make: Maker, corner: Point, across: Point, up: Point, material: Material) -> Part:
    """A sheet with one print."""
    part = quad(corner, across, up, material)
    return on_cell(make, part, part.uvs[:, 0], part.uvs[:, 1])


def printed_band(
    make: Maker, radius: Number, low: Number, high: Number, material: Material
) -> Part:
    """A label around the z axis."""
    part = lathe([(radius, low), (radius, high)], material, 14)
    angle = np.arctan2(part.vertices[:, 1], part.vertices[:, 0])
    up = (part.vertices[:, 2] - low) / (high - low)
    return on_cell(make, part, np.abs(angle) / np.pi, up)


def sheets(make: Maker, count: int, size: tuple[Number, Number], spread: Number) -> list[Part]:
    """Sheets of paper that lie on each other, shifted by up to `spread` and turned."""
    paper, parts = make.papers(), []
    for i in range(count):
        width, depth = size
        flat = printed_box(make, (0, 0, 0), (width, depth, 0.004), paper)
        turn = rot_z(make.uniform(-1, 1) * min(1.0, 8 * spread))
        offset = make.uniform(-spread, spread), make.uniform(-spread, spread), 0.004 * (i + 0.5)
        parts.append(flat.moved(turn, offset))
    return parts
