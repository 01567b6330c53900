"""The finished room as one triangle mesh with materials and instances."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from instok3d.rooms.classes import STUFF
from instok3d.rooms.colors import color_name
from instok3d.rooms.materials import Material
from instok3d.rooms.plan import Placed
from instok3d.rooms.primitives import Part, rot_z


@dataclass(frozen=True)
class Mesh:
    """World coordinates: z up, metres, the room's corner at the origin."""

    vertices: Float[np.ndarray, "vertex 3"]
    normals: Float[np.ndarray, "vertex 3"]
    uvs: Float[np.ndarray, "vertex 2"]
    """In tiles of the texture."""
    faces: Int[np.ndarray, "face 3"]
    face_material: Int[np.ndarray, " face"]
    face_instance: Int[np.ndarray, " face"]
    """Instance ids, from 1."""
    materials: tuple[Material, ...]


def _areas(part: Part) -> np.ndarray:
    corners = part.vertices[part.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return 0.5 * np.linalg.norm(normals, axis=1)


def build_mesh(placed: list[Placed]) -> Mesh:
    """All objects in world coordinates, in float32."""
    materials: dict[int, Material] = {}
    index: dict[int, int] = {}
    rows: list[tuple[np.ndarray, ...]] = []
    start = 0
    for instance, item in enumerate(placed, 1):
        turn, offset = rot_z(item.angle_rad), (item.x, item.y, item.z)
        for part in item.furniture.parts:
            material = part.material
            number = index.setdefault(id(material), len(index))
            materials[number] = material
            moved = part.moved(turn, offset)
            count = len(part.faces)
            rows.append((
                moved.vertices, moved.normals, part.uvs / material.tile_m, part.faces + start,
                np.full(count, number), np.full(count, instance),
            ))  # fmt: skip
            start += len(part.vertices)
    columns = [np.concatenate(column) for column in zip(*rows, strict=True)]
    floats = [np.ascontiguousarray(c, np.float32) for c in columns[:3]]
    ints = [np.ascontiguousarray(c, np.int32) for c in columns[3:]]
    kinds = tuple(materials[i] for i in range(len(materials)))
    return Mesh(floats[0], floats[1], floats[2], ints[0], ints[1], ints[2], kinds)


def attributes(placed: list[Placed], mesh: Mesh) -> list[dict]:
    """What is known of every instance, as it is stored: class, colour, material, size, box."""
    records = []
    for instance, item in enumerate(placed, 1):
        area: dict[int, float] = {}
        kinds: dict[int, Material] = {}
        for part in item.furniture.parts:
            key = id(part.material)
            kinds[key] = part.material
            area[key] = area.get(key, 0.0) + float(_areas(part).sum())
        main = kinds[max(area, key=lambda key: area[key])]
        color = main.texture[::8, ::8].reshape(-1, 3).mean(0) / 255
        used = np.unique(mesh.faces[mesh.face_instance == instance])
        corners = mesh.vertices[used]
        records.append({
            "id": instance, "class": item.furniture.name, 
            "generator": item.furniture.source or item.generator,
            "stuff": item.furniture.name in STUFF, "color": color_name(color),
            "material": main.kind, "size_m": [round(s, 3) for s in item.furniture.size],
            "parent": item.parent,
            "aabb_m": [[round(float(v), 3) for v in corners.min(0)],
                       [round(float(v), 3) for v in corners.max(0)]],
        })  # fmt: skip
    return records
