"""Furniture models of a catalogue, which stand in for generators of the same class."""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from instok3d.reading import naming_damage, number
from instok3d.rooms.catalogues.entries import (
    CATALOGUE,
    Entry,
    license_fault,
    usable_entries,
)
from instok3d.rooms.catalogues.entries import REMEDY as CATALOGUE_REMEDY
from instok3d.rooms.catalogues.glb import GlbPart, Surface, read_glb
from instok3d.rooms.catalogues.model_classes import ON_WALLS, class_of, generator_of
from instok3d.rooms.catalogues.shading import corner_normals
from instok3d.rooms.catalogues.supports import ROUGH_M, level_supports
from instok3d.rooms.materials import Material
from instok3d.rooms.objects.base import Furniture, standing, wall_mounted
from instok3d.rooms.primitives import Part
from instok3d.rooms.textures import resampled, uniform

MAX_FACES = 40_000
SIDES_M = (0.02, 6.0)
"""Least and most of a model's longest side; another one is hardly in metres."""
MAX_HOLES = 0.2
"""Share of a model's surface that its opacity may cut out: the ray tracer knows no holes."""
MAX_ELEVATION_M = 2.0
MIN_AREA_M2 = 1e-10
"""Smaller triangles are left out."""
MAX_TILES = 1000.0
"""Most repetitions of a picture on one face."""
SHARE = 0.5
"""Of the pieces of a class that has many models are models."""
RARE = 2.0
"""A class with so many models has half the share, so that a lone model is not everywhere."""
CACHED = 160
"""Models that a process keeps in memory."""
SUPPORTING = (
    "bookshelf", "cabinet", "coffee table", "counter", "desk", "dresser", "nightstand", "piano",
    "side table", "sofa", "table", "tv stand", "washing machine",
)  # fmt: skip
"""Classes on which things stand, as they do on what the generators make."""


@dataclass(frozen=True)
class FurnitureCatalogue:
    """The models of a folder that rooms may use."""

    folder: Path
    entries: tuple[Entry, ...]
    left_out: dict[str, int]
    """How many records are not used, by the reason."""

    @staticmethod
    def open(folder: Path) -> "FurnitureCatalogue":
        """Read a catalogue, and once every model in it that rooms may use.

        Raises:
            FileNotFoundError: The folder has no catalogue, or a model is missing.
            ValueError: The catalogue or a model is damaged, or no model is usable.
        """

        def judged(record: dict[str, Any]) -> tuple[Entry, str]:
            file = Path(record["file"])
            use = generator_of(file.stem, record["name"])
            with naming_damage(folder / CATALOGUE, CATALOGUE_REMEDY):
                elevation_m = number(record.get("elevation_m", 0.0))
            people = (record["name"], record["creator"], record["license"])
            entry = Entry(file, *people, use, elevation_m)
            fault = "of no class of the rooms" if not use else license_fault(entry)
            return entry, fault or model_fault(folder, entry)

        return FurnitureCatalogue(
            folder, *usable_entries(folder, "model", ("name", "creator"), judged)
        )

    def draw(self, rng: np.random.Generator, generator: str) -> Furniture | None:
        """A model in place of what a generator makes, or None: half of the time at least."""
        fitting = [entry for entry in self.entries if entry.use == generator]
        if not fitting or rng.random() >= SHARE * len(fitting) / (len(fitting) + RARE):
            return None
        entry = fitting[int(rng.integers(len(fitting)))]
        path, name = self.folder / entry.file, class_of(generator)
        if generator in ON_WALLS:
            return load_model(path, name, on_wall=True)
        return load_model(path, name, entry.elevation_m)


@lru_cache(CACHED)
def load_model(path: Path, name: str, elevation_m: float = 0.0, on_wall: bool = False) -> Furniture:
    """A model as furniture: front to -y, z up, on the floor, above it, or on a wall.

    Args:
        path: The GLB file, in metres, with its front to the file's +z.
        name: Its class.
        elevation_m: How high above the floor its lowest point is.
        on_wall: Its origin is the middle of its back, not of its footprint.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged.
    """
    parts = [part for part in map(_part, read_glb(path)) if len(part.faces)]
    model = wall_mounted(name, parts) if on_wall else standing(name, parts)
    if name in SUPPORTING and not (on_wall or elevation_m):
        supports = level_supports(model.parts, ROUGH_M if name == "sofa" else 0.0)
        model = replace(model, supports=supports)
    width, depth, height = model.size
    return replace(
        model,
        parts=tuple(_compact(part.moved(offset=(0, 0, elevation_m))) for part in model.parts),
        size=(width, depth, height + elevation_m),
        source=f"model:{path.stem}",
    )


def _compact(part: Part) -> Part:
    """The part in half the memory: many models stay in it."""
    return replace(
        part,
        vertices=part.vertices.astype(np.float32),
        normals=part.normals.astype(np.float32),
        uvs=part.uvs.astype(np.float32),
        faces=part.faces.astype(np.int32),
    )


def model_fault(folder: Path, entry: Entry) -> str:
    """Why rooms cannot use a sound model; "" where they can.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged.
    """
    path = folder / entry.file
    parts = read_glb(path)
    if sum(len(part.faces) for part in parts) > MAX_FACES:
        return f"more than {MAX_FACES:,} faces"
    corners = np.concatenate([part.vertices[part.faces] for part in parts] or [np.zeros((0, 3, 3))])
    corners = corners[_areas(corners) > MIN_AREA_M2].reshape(-1, 3)
    if not len(corners):
        return "without triangles"
    longest = float((corners.max(0) - corners.min(0)).max())
    if not SIDES_M[0] <= longest <= SIDES_M[1]:
        return f"longest side outside {SIDES_M[0]:g} to {SIDES_M[1]:g} m"
    if not 0 <= entry.elevation_m <= MAX_ELEVATION_M:
        return f"elevation outside 0 to {MAX_ELEVATION_M:g} m"
    if _holes(parts) > MAX_HOLES:
        return "cut out by transparency"
    return ""


def _areas(corners: Float[np.ndarray, "face 3 3"]) -> Float[np.ndarray, " face"]:
    crossed = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.linalg.norm(crossed, axis=1) / 2


def _holes(parts: list[GlbPart]) -> float:
    """Share of the surface where a picture says that there is none, by samples on each face."""
    weights = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]], float)
    weights /= weights.sum(1, keepdims=True)
    missing = total = 0.0
    for part in parts:
        area = _areas(part.vertices[part.faces])
        total += float(area.sum())
        picture, uvs = part.surface.picture, part.uvs
        if picture is None or uvs is None or part.surface.alpha == "OPAQUE":
            continue
        spots = (weights @ uvs[part.faces]) % 1.0
        height, width = picture.shape[:2]
        column = np.minimum((spots[..., 0] * width).astype(int), width - 1)
        row = np.minimum((spots[..., 1] * height).astype(int), height - 1)
        cutoff = 255 * (part.surface.cutoff if part.surface.alpha == "MASK" else 0.5)
        missing += float(((picture[row, column, 3] < cutoff).mean(1) * area).sum())
    return missing / max(total, 1e-12)


def _part(part: GlbPart) -> Part:
    """A part in the frame of furniture, with vertices of its own for every triangle."""
    x, up, front = part.vertices.T
    vertices = np.stack([x, -front, up], 1)
    faces = part.faces[_areas(vertices[part.faces]) > MIN_AREA_M2]
    corners = vertices[faces]
    uvs, tile_m = np.zeros((len(corners) * 3, 2)), 1.0
    if part.uvs is not None:
        upwards = _near_zero(np.stack([part.uvs[:, 0], 1 - part.uvs[:, 1]], 1)[faces])
        tile_m = _tile_m(upwards, float(_areas(corners).sum()))
        uvs = upwards.reshape(-1, 2) * tile_m
    normals = corner_normals(vertices, faces)
    return Part(
        corners.reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3),
        normals.reshape(-1, 3), uvs, _material(part.surface, tile_m),
    )  # fmt: skip


def _near_zero(uvs: Float[np.ndarray, "face 3 2"]) -> Float[np.ndarray, "face 3 2"]:
    """Each face moved by whole tiles to the first one: exported files hold numbers like 3e9."""
    moved = uvs - np.floor(uvs.min(1, keepdims=True))
    return np.clip(moved, 0, MAX_TILES)


def _tile_m(uvs: Float[np.ndarray, "face 3 2"], area_m2: float) -> float:
    """Side of the whole picture on the surface: by it the renderer chooses the mip level."""
    a, b = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    covered = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2
    return float(np.clip(np.sqrt(area_m2 / max(covered, 1e-9)), 1e-3, 100.0))


def _material(surface: Surface, tile_m: float) -> Material:
    """A part's look; its linear factor on the linear picture is one on sRGB at gamma 2.2."""
    factor = surface.factor[:3] ** (1 / 2.2)
    if surface.picture is None:
        texture = uniform(factor)
    else:
        texture = resampled(surface.picture[..., :3], factor)
    clear = surface.alpha == "BLEND" and surface.factor[3] < 0.7
    kind = "metal" if surface.metallic > 0.5 else "glass" if clear else "unknown"
    gloss = 0.25 * max(surface.metallic, 1 - surface.roughness, 0.8 if clear else 0.0)
    return Material(kind, texture, tile_m, gloss)
