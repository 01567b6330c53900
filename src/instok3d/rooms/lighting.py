"""The lamps, windows and screens of a room as triangles to sample, and how bright they are."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from instok3d.rooms.colors import light_color
from instok3d.rooms.mesh import Mesh
from instok3d.rooms.room import Room

GUIDE_SIZE = 4096
"""Slots that emitters share by their power: one uniform number picks one."""


@dataclass(frozen=True)
class Lights:
    """Emitting triangles with everything that one light sample needs, in float32."""

    emission: Float[np.ndarray, " material"]
    """Radiance relative to the texture; lights the room."""
    visible: Float[np.ndarray, " material"]
    """Radiance relative to the texture as the camera sees it."""
    corners: Float[np.ndarray, "emitter 3"]
    first_edges: Float[np.ndarray, "emitter 3"]
    second_edges: Float[np.ndarray, "emitter 3"]
    normals: Float[np.ndarray, "emitter 3"]
    weights: Float[np.ndarray, "emitter 3"]
    """Radiance x area / probability / pi."""
    guide: Int[np.ndarray, " slot"]
    """Emitter of every slot; an emitter's probability is its share of the slots."""


def draw_emission(room: Room, rng: np.random.Generator) -> Float[np.ndarray, " material"]:
    """Radiance of every material; sometimes with the ceiling lamps off where others shine."""
    mesh, unlit = room.mesh, rng.random() < room.level.unlit
    emission = np.array([m.emission for m in mesh.materials], np.float32)
    ceiling = [i for i, p in enumerate(room.plan.placed, 1) if p.generator == "ceiling_lamp"]
    off = np.unique(mesh.face_material[np.isin(mesh.face_instance, ceiling)])
    others = np.delete(np.arange(len(emission)), off)
    strong = [i for i in others if mesh.materials[i].light != "screen" and emission[i] > 0.5]
    if unlit and strong:
        emission[off] = 0
    return emission


def build_lights(
    mesh: Mesh,
    emission: Float[np.ndarray, " material"],
    lamp_visible: float,
    window_visible: float,
    mean_colors: Float[np.ndarray, "material 3"],
) -> Lights:
    """Tables of all emitting triangles for these radiances; cameras see less of the brightest."""
    face = np.nonzero(emission[mesh.face_material] > 0)[0]
    corners = mesh.vertices[mesh.faces[face]]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normals = np.cross(first, second)
    area = 0.5 * np.linalg.norm(normals, axis=1)
    normals /= 2 * area[:, None] + 1e-12
    material = mesh.face_material[face]
    radiance = emission[material][:, None] * mean_colors[material]
    power = area * radiance.mean(1)
    slots = np.maximum(1, np.round(power / power.sum() * GUIDE_SIZE)).astype(int)
    probability = slots / slots.sum()
    weights = radiance * (area / probability / np.pi)[:, None]
    visible = np.minimum(emission, lamp_visible)
    for i, m in enumerate(mesh.materials):
        if m.light == "window":
            visible[i] = min(emission[i], window_visible)
    return Lights(
        emission=emission,
        visible=visible,
        corners=np.ascontiguousarray(corners[:, 0], np.float32),
        first_edges=np.ascontiguousarray(first, np.float32),
        second_edges=np.ascontiguousarray(second, np.float32),
        normals=np.ascontiguousarray(normals, np.float32),
        weights=np.ascontiguousarray(weights, np.float32),
        guide=np.repeat(np.arange(len(face), dtype=np.int32), slots),
    )


@dataclass(frozen=True)
class Sun:
    """Parallel light that enters through windows."""

    direction: Float[np.ndarray, " 3"]
    """Unit, towards the sun."""
    irradiance: Float[np.ndarray, " 3"]
    """Over pi, on a surface that faces the sun."""


def draw_sun(room: Room, rng: np.random.Generator) -> Sun | None:
    """A sun that one of the windows of a room in daylight lets in, or None."""
    mesh = room.mesh
    panes = [i for i, m in enumerate(mesh.materials) if m.light == "window" and m.emission > 1]
    shines, elevation = rng.random() < room.level.sun, rng.uniform(0.25, 1.0)
    aside, strength = rng.uniform(-0.9, 0.9), rng.uniform(0.6, 5.0)
    warmth = light_color(rng.uniform(4200, 6000)) ** 2.2
    if not shines or not panes:
        return None
    face = int(rng.choice(np.nonzero(np.isin(mesh.face_material, panes))[0]))
    x, y, _ = mesh.normals[mesh.faces[face, 0]]
    azimuth = np.arctan2(-y, -x) + aside  # panes face into the room
    flat = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])
    direction = np.append(flat, np.sin(elevation)).astype(np.float32)
    return Sun(direction, (strength * warmth).astype(np.float32))
