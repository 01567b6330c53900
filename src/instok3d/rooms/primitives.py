"""Parametric solids and sheets as triangle meshes. z is up, metres; texture v runs upwards."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull

from instok3d.rooms.colors import Number
from instok3d.rooms.materials import Material

Point = Sequence[Number] | Float[np.ndarray, " 3"]


@dataclass(frozen=True)
class Part:
    """A triangle mesh of one material."""

    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    normals: Float[np.ndarray, "vertex 3"]
    uvs: Float[np.ndarray, "vertex 2"]
    """Metres along the surface, or 0..1 over the whole picture for fitted materials."""
    material: Material

    def moved(
        self, rotation: Float[np.ndarray, "3 3"] | None = None, offset: Point = (0, 0, 0)
    ) -> "Part":
        """The part turned about the origin, then shifted."""
        turn = np.eye(3) if rotation is None else rotation
        vertices = self.vertices @ turn.T + np.asarray(offset, float)
        return replace(self, vertices=vertices, normals=self.normals @ turn.T)

    def scaled(self, factors: Point) -> "Part":
        """The part stretched along the axes; normals are left as they are."""
        return replace(self, vertices=self.vertices * np.asarray(factors, float))

    def mapped(self, uvs: Float[np.ndarray, "vertex 2"]) -> "Part":
        """The part with other texture coordinates."""
        return replace(self, uvs=uvs)


def rot_x(angle_rad: Number) -> Float[np.ndarray, "3 3"]:
    """Rotation about x."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def rot_z(angle_rad: Number) -> Float[np.ndarray, "3 3"]:
    """Rotation about z."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


_SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
_BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def _bevelled_faces() -> Int[np.ndarray, "face 3"]:
    """Triangles of a cube with cut edges; vertex 3 c + a is corner c pushed out along axis a."""
    points = np.repeat(_SIGNS * 0.8, 3, axis=0)
    for axis in range(3):
        points[axis::3, axis] = _SIGNS[:, axis]
    faces = ConvexHull(points).simplices.copy()
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (normals * corners.mean(1)).sum(1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return faces


_BEVELLED_FACES = _bevelled_faces()


def _flat_shaded(vertices: np.ndarray, faces: np.ndarray, material: Material) -> Part:
    """Own vertices for every triangle; texture projected along the dominant axis."""
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    points, normals = corners.reshape(-1, 3), np.repeat(normals, 3, axis=0)
    axis = np.abs(normals).argmax(1)
    across = np.where(axis == 0, points[:, 1], points[:, 0])
    up = np.where(axis == 2, points[:, 1], points[:, 2])
    uvs = np.stack([across, up], 1)
    return Part(points, np.arange(len(points)).reshape(-1, 3), normals, uvs, material)


def box(center: Point, size: Point, material: Material, bevel: Number = 0.0) -> Part:
    """A box of full size `size` with edges cut off at `bevel`."""
    half = np.asarray(size, float) / 2
    cut = min(bevel, 0.9 * half.min())
    if cut <= 0:
        return _flat_shaded(_SIGNS * half + np.asarray(center, float), _BOX_FACES, material)
    points = np.repeat(_SIGNS * (half - cut), 3, axis=0)
    for axis in range(3):
        points[axis::3, axis] = _SIGNS[:, axis] * half[axis]
    return _flat_shaded(points + np.asarray(center, float), _BEVELLED_FACES, material)


def quad(corner: Point, across: Point, up: Point, material: Material, fitted: bool = True) -> Part:
    """A parallelogram whose normal is across x up; uvs 0..1, or metres if not `fitted`."""
    o, u, v = (np.asarray(a, float) for a in (corner, across, up))
    normal = np.cross(u, v)
    normal /= np.linalg.norm(normal)
    width, height = (1.0, 1.0) if fitted else (np.linalg.norm(u), np.linalg.norm(v))
    uvs = np.array([[0, 0], [width, 0], [width, height], [0, height]], float)
    vertices = np.array([o, o + u, o + u + v, o + v])
    return Part(vertices, np.array([[0, 1, 2], [0, 2, 3]]), np.tile(normal, (4, 1)), uvs, material)


def grid(
    points: Float[np.ndarray, "row column 3"],
    normals: Float[np.ndarray, "row column 3"],
    uvs: Float[np.ndarray, "row column 2"],
    material: Material,
) -> Part:
    """A sheet through a grid of points; triangles are wound to agree with the normals."""
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
    c, d = index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    vertices, flat_normals = points.reshape(-1, 3), normals.reshape(-1, 3)
    corners = vertices[faces]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    solid = np.linalg.norm(face_normals, axis=1) > 1e-12
    faces, face_normals = faces[solid], face_normals[solid]
    flipped = (face_normals * flat_normals[faces].sum(1)).sum(1) < 0
    faces[flipped] = faces[flipped][:, ::-1]
    return Part(vertices, faces, flat_normals, uvs.reshape(-1, 2), material)


def merged(parts: Sequence[Part]) -> Part:
    """Parts of one material as a single part."""
    starts = np.cumsum([0] + [len(p.vertices) for p in parts[:-1]])
    return Part(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.faces + start for p, start in zip(parts, starts, strict=True)]),
        np.concatenate([p.normals for p in parts]),
        np.concatenate([p.uvs for p in parts]),
        parts[0].material,
    )


def lathe(
    profile: Sequence[tuple[Number, Number]],
    material: Material,
    sides: int = 20,
    base: Point = (0, 0, 0),
    smooth: bool = False,
) -> Part:
    """A profile of (radius, z), from bottom to top as seen from outside, turned about z.

    Each segment of the profile is shaded by itself unless `smooth`.
    """
    outline = np.asarray(profile, float)
    lengths = np.linalg.norm(np.diff(outline, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    circle = np.stack([np.cos(angle), np.sin(angle)], 1)
    radius = max(outline[:, 0].max(), 0.02)
    spans = [slice(None)] if smooth else [slice(i, i + 2) for i in range(len(outline) - 1)]
    rings = []
    for span in spans:
        part, rise = outline[span], along[span]
        slope = np.gradient(part, axis=0)
        normal = np.stack([slope[:, 1], -slope[:, 0]], 1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-9
        shape = (sides + 1, len(part), 1)
        heights = np.broadcast_to(part[None, :, 1:], shape)
        points = np.concatenate([circle[:, None] * part[None, :, :1], heights], -1)
        tilt = np.broadcast_to(normal[None, :, 1:], shape)
        normals = np.concatenate([circle[:, None] * normal[None, :, :1], tilt], -1)
        around = np.broadcast_to(angle[:, None, None] * radius, shape)
        uvs = np.concatenate([around, np.broadcast_to(rise[None, :, None], shape)], -1)
        rings.append(grid(points, normals, uvs, material))
    return merged(rings).moved(offset=base)


def cylinder(
    base: Point,
    radius: Number,
    height: Number,
    material: Material,
    sides: int = 16,
) -> Part:
    """An upright closed cylinder on `base`."""
    profile = [(1e-4, 0.0), (radius, 0.0), (radius, height), (1e-4, height)]
    return lathe(profile, material, sides, base)


def rod(start: Point, end: Point, radius: Number, material: Material, sides: int = 8) -> Part:
    """A cylinder from point to point."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    length = float(np.linalg.norm(end - start))
    z = (end - start) / length
    x = np.cross([1.0, 0, 0] if abs(z[0]) < 0.9 else [0, 1.0, 0], z)
    x /= np.linalg.norm(x)
    turn = np.stack([x, np.cross(z, x), z], 1)
    return cylinder((0, 0, 0), radius, length, material, sides).moved(turn, start)


def _signed_power(x: np.ndarray, exponent: Number) -> np.ndarray:
    return np.sign(x) * np.abs(x) ** exponent


def cushion(
    center: Point,
    size: Point,
    material: Material,
    vertical: Number = 0.3,
    horizontal: Number = 0.3,
    sides: int = 20,
    rings: int = 12,
) -> Part:
    """A superellipsoid of full size `size`; roundness 0 is a box, 1 an ellipsoid."""
    a, b, c = np.asarray(size, float) / 2
    u = np.linspace(-np.pi, np.pi, sides + 1)[:, None]
    v = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)[None]
    cos_u, sin_u, cos_v, sin_v = np.cos(u), np.sin(u), np.cos(v), np.sin(v)

    def surface(e1: Number, e2: Number, x: Number, y: Number, z: Number) -> np.ndarray:
        ring = _signed_power(cos_v, e1)
        top = _signed_power(sin_v, e1) * z + 0 * u
        return np.stack(
            [ring * _signed_power(cos_u, e2) * x, ring * _signed_power(sin_u, e2) * y, top], -1
        )

    points = surface(vertical, horizontal, a, b, c)
    normals = surface(2 - vertical, 2 - horizontal, 1 / a, 1 / b, 1 / c)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True) + 1e-12
    uvs = np.stack([u * max(a, b) + 0 * v, v * (c + 0.5 * min(a, b)) + 0 * u], -1)
    return grid(points, normals, uvs, material).moved(offset=center)


def ball(
    center: Point, radius: Number, material: Material, sides: int = 10, rings: int = 8
) -> Part:
    """A sphere."""
    return cushion(center, (2 * radius,) * 3, material, 1.0, 1.0, sides, rings)


def drape(
    outline: Float[np.ndarray, "point 2"], bottom: Number, top: Number, material: Material
) -> Part:
    """A vertical sheet over a polyline on the floor; it is seen from both sides."""
    tangent = np.gradient(outline, axis=0)
    normal = np.stack([tangent[:, 1], -tangent[:, 0], np.zeros(len(outline))], 1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-9
    steps = np.linalg.norm(np.diff(outline, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    rows = [
        (
            np.column_stack([outline, np.full(len(outline), z)]),
            np.column_stack([along, along * 0 + z]),
        )
        for z in (bottom, top)
    ]
    points, uvs = (np.stack(layers, 1) for layers in zip(*rows, strict=True))
    return grid(points, np.repeat(normal[:, None], 2, 1), uvs, material)


def tube(
    path: Float[np.ndarray, "point 3"], radius: Number, material: Material, sides: int = 5
) -> Part:
    """An open tube along a path, such as a cable; neighbouring points must differ."""
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True) + 1e-12
    aside = np.cross(along, [0.31, 0.47, 0.83])  # a direction that no cable here runs in
    aside /= np.linalg.norm(aside, axis=1, keepdims=True) + 1e-12
    above = np.cross(along, aside)
    angle = np.linspace(0, 2 * np.pi, sides + 1)[None, :, None]
    normals = np.cos(angle) * aside[:, None] + np.sin(angle) * above[:, None]
    steps = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    around = np.broadcast_to(angle[..., 0] * radius, normals.shape[:2])
    uvs = np.stack([around, np.broadcast_to(steps[:, None], normals.shape[:2])], -1)
    return grid(path[:, None] + radius * normals, normals, uvs, material)
