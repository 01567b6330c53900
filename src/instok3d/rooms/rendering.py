"""Path tracing of a room: light samples, one bounce, an ambient rest, reflections, denoising."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt16

from instok3d.rooms.denoising import Denoiser
from instok3d.rooms.lighting import Sun, build_lights, draw_emission, draw_sun
from instok3d.rooms.room import Room
from instok3d.rooms.textures import SIZE
from instok3d.rooms.tracing import EmbreeTracer, Rays, Tracer

F32 = np.float32
LINEAR = ((np.arange(256) / 255.0) ** 2.2).astype(F32)
"""Linear value of every sRGB byte."""
MEAN_IRRADIANCE = 0.45
"""Lamps and windows are scaled so that surfaces receive this, over pi, on average."""
OFFSET_M = 1e-3
"""Secondary rays start this far above the surface."""


@dataclass(frozen=True)
class Frame:
    """One rendered view."""

    radiance: Float[np.ndarray, "height width 3"]
    """Linear, before exposure."""
    depth_m: Float[np.ndarray, "height width"]
    """z-depth at the pixel centres; 0 = nothing hit."""
    instances: UInt16[np.ndarray, "height width"]
    """Instance ids at the pixel centres; 0 = nothing hit."""


@dataclass(frozen=True)
class Surface:
    """Shading points."""

    points: Rays
    normals: Rays
    """Unit, towards the ray's origin."""
    uvs: Float[np.ndarray, "ray 2"]
    materials: np.ndarray


def _dot(a: Rays, b: Rays) -> np.ndarray:
    return np.einsum("ij,ij->i", a, b)


def _texture_pyramids(textures: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Linear texels of all mip levels, where each level starts, and the textures' mean colours."""
    level = LINEAR[textures]
    levels, offsets, total = [], [], 0
    while True:
        levels.append(level.reshape(-1, 3))
        offsets.append(total)
        total += len(levels[-1])
        if level.shape[1] == 4:
            break
        rows = level[:, ::2] + level[:, 1::2]
        level = F32(0.25) * (rows[:, :, ::2] + rows[:, :, 1::2])
    return np.concatenate(levels), np.array(offsets), level.mean((1, 2))


def camera_rays(
    intrinsics: Float[np.ndarray, "3 3"],
    world_from_cam: Float[np.ndarray, "4 4"],
    height: int,
    width: int,
    offset: tuple[float, float] = (0.5, 0.5),
) -> tuple[Rays, Rays]:
    """Origins and directions through a point of every pixel; the distance to a hit is z-depth."""
    x, y = np.meshgrid(np.arange(width) + offset[0], np.arange(height) + offset[1])
    x = (x - intrinsics[0, 2]) / intrinsics[0, 0]
    y = (y - intrinsics[1, 2]) / intrinsics[1, 1]
    local = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3).astype(F32)
    directions = local @ world_from_cam[:3, :3].T.astype(F32)
    origins = np.empty_like(directions)
    origins[:] = world_from_cam[:3, 3]
    return origins, directions


class Renderer:
    """Renders views of one room; all tables are float32 and made once."""

    def __init__(
        self,
        room: Room,
        rng: np.random.Generator,
        denoiser: Denoiser | None,
        tracer: Tracer | None = None,
    ):
        mesh = room.mesh
        self.mesh, self.denoiser = mesh, denoiser
        self.level = room.level
        self.sun = None
        self.tracer = tracer or EmbreeTracer(mesh.vertices, mesh.faces)
        attributes = np.concatenate([mesh.normals, mesh.uvs], 1)[mesh.faces]
        attributes[:, 1:] -= attributes[:, :1]
        self._attributes = attributes  # per face: value at corner 0, steps to corners 1 and 2
        textures = np.stack([m.texture for m in mesh.materials])
        self._texels, self._offsets, self._means = _texture_pyramids(textures)
        self._tile_m = np.array([m.tile_m for m in mesh.materials], F32)
        self._gloss = np.array([m.gloss for m in mesh.materials], F32)
        visible = self.level.lamp_visible, float(rng.uniform(*self.level.window_visible))
        emission = draw_emission(room, rng)
        self.lights = build_lights(mesh, emission, *visible, self._means)
        self._calibrate(rng, emission, visible)
        self.ambient *= F32(rng.uniform(*self.level.ambient))
        self._panes = np.array([m.light == "window" for m in mesh.materials])
        self.sun = draw_sun(room, rng)

    def _calibrate(
        self, rng: np.random.Generator, emission: np.ndarray, visible: tuple[float, float]
    ) -> None:
        """Scale lamps and windows to the wanted mean irradiance, and set the ambient light."""
        mesh = self.mesh
        corners = mesh.vertices[mesh.faces]
        first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        normals = np.cross(first, second)
        area = np.linalg.norm(normals, axis=1).astype(np.float64)
        face = rng.choice(len(area), 1500, p=area / area.sum())
        face = face[emission[mesh.face_material[face]] <= 0]
        a, b = np.sqrt(rng.random(len(face), F32)), rng.random(len(face), F32)
        points = (
            corners[face, 0]
            + first[face] * (a * (1 - b))[:, None]
            + second[face] * (a * b)[:, None]
        )
        normals = mesh.normals[mesh.faces[face, 0]]
        light = sum(self._direct(rng, points, normals) for _ in range(6)) / 6
        light = np.minimum(light, np.percentile(light, 97)).mean(0)
        gain = F32(MEAN_IRRADIANCE / max(float(light.mean()), 1e-4))
        screens = np.array([m.light == "screen" for m in mesh.materials])
        scaled = np.where(screens, emission, emission * gain).astype(F32)
        self.lights = build_lights(mesh, scaled, *visible, self._means)
        albedo = self._means[mesh.face_material[face]].mean(0)
        self.ambient = (light * gain * albedo / (1 - np.minimum(albedo, 0.75))).astype(F32)

    def _surface(
        self,
        origins: Rays,
        directions: Rays,
        face: np.ndarray,
        u: np.ndarray,
        v: np.ndarray,
        t: np.ndarray,
    ) -> Surface:
        values = self._attributes[face]
        mixed = values[:, 0] + u[:, None] * values[:, 1] + v[:, None] * values[:, 2]
        normals = mixed[:, :3]
        facing = np.where(_dot(normals, directions) > 0, F32(-1), F32(1))
        normals = normals * (facing / np.sqrt(_dot(normals, normals) + F32(1e-20)))[:, None]
        points = origins + directions * t[:, None]
        return Surface(points, normals, mixed[:, 3:], self.mesh.face_material[face])

    def _albedo(self, surface: Surface, footprint_m: np.ndarray) -> Rays:
        """Texture colours, from the mip level whose texel is nearest to the footprint."""
        m = surface.materials
        texels = np.maximum(footprint_m / self._tile_m[m] * SIZE, F32(1))
        level = np.minimum(np.rint(np.log2(texels)).astype(np.int32), len(self._offsets) - 1)
        side = np.int32(SIZE) >> level
        mask = side - 1
        x = np.floor(surface.uvs[:, 0] * side).astype(np.int32) & mask
        y = mask - (np.floor(surface.uvs[:, 1] * side).astype(np.int32) & mask)
        index = self._offsets[level] + ((m * side + y) * side + x)
        return self._texels.take(index, axis=0)

    def _direct(self, rng: np.random.Generator, points: Rays, normals: Rays) -> Rays:
        """Irradiance over pi from one light sample a point."""
        lights, count = self.lights, len(points)
        slot, a, b = rng.random((3, count), F32)
        emitter = lights.guide[(slot * F32(len(lights.guide))).astype(np.int32)]
        a = np.sqrt(a)
        along, across = (a * (1 - b))[:, None], (a * b)[:, None]
        to_light = lights.corners[emitter] - points
        to_light += lights.first_edges[emitter] * along
        to_light += lights.second_edges[emitter] * across
        square = _dot(to_light, to_light)
        cosines = np.maximum(_dot(to_light, normals), 0) * np.abs(
            _dot(to_light, lights.normals[emitter])
        )
        weight = cosines / (square * np.maximum(square, F32(0.01)))
        useful = np.nonzero(weight > 1e-6)[0]
        light = np.zeros_like(points)
        if len(useful):
            start = points[useful] + normals[useful] * F32(OFFSET_M)
            reach = 1 - F32(4e-3) / np.sqrt(square[useful])
            lit = useful[~self.tracer.occluded(start, to_light[useful], reach)]
            light[lit] = lights.weights[emitter[lit]] * weight[lit][:, None]
        if self.sun:
            light += self._sunlight(self.sun, points, normals)
        return light

    def _sunlight(self, sun: Sun, points: Rays, normals: Rays) -> Rays:
        """Irradiance over pi from the sun: on points that see it through a window."""
        cosines = normals @ sun.direction
        facing = np.nonzero(cosines > 0)[0]
        light = np.zeros_like(points)
        if len(facing):
            start = points[facing] + normals[facing] * F32(OFFSET_M)
            rays = np.tile(sun.direction, (len(facing), 1))
            face = self.tracer.trace(start, rays).face
            lit = facing[(face >= 0) & self._panes[self.mesh.face_material[face]]]
            light[lit] = cosines[lit, None] * sun.irradiance
        return light

    def _incoming(
        self, rng: np.random.Generator, starts: Rays, directions: Rays
    ) -> tuple[Rays, np.ndarray]:
        """Light that comes back along rays from diffuse surfaces, and the materials hit."""
        hits = self.tracer.trace(starts, directions)
        hit = hits.face >= 0
        distance = np.where(hit, hits.distance, F32(1))
        there = self._surface(
            starts, directions, np.where(hit, hits.face, 0), hits.u, hits.v, distance
        )
        light = np.minimum(self._direct(rng, there.points, there.normals), F32(4)) + self.ambient
        light *= self._means[there.materials]
        light[~hit | (self.lights.emission[there.materials] > 0)] = 0
        return light, there.materials

    def _bounced(
        self, rng: np.random.Generator, surface: Surface, directions: Rays, albedo: Rays
    ) -> Rays:
        """Light by way of one other surface: diffuse, and reflected where materials are glossy."""
        count = len(directions)
        starts = surface.points + surface.normals * F32(OFFSET_M)
        aims = surface.normals + F32(0.999) * _unit_sphere(rng, count)
        if not self.level.gloss:
            return albedo * self._incoming(rng, starts, aims)[0]
        gloss = self._gloss[surface.materials]
        shiny = np.nonzero(gloss > 0)[0]
        normals, rays = surface.normals[shiny], directions[shiny]
        toward = _dot(normals, rays)
        mirrored = rays - 2 * toward[:, None] * normals
        mirrored += F32(0.06) * _unit_sphere(rng, len(shiny))
        light, hit = self._incoming(
            rng, np.concatenate([starts, starts[shiny]]), np.concatenate([aims, mirrored])
        )
        bounced = albedo * light[:count]
        shown = self.lights.visible[hit[count:], None] * self._means[hit[count:]]
        grazing = (1 + np.minimum(toward, 0)) ** 3
        strength = gloss[shiny] * (F32(0.4) + F32(1.6) * grazing)
        bounced[shiny] += strength[:, None] * np.minimum(light[count:] + shown, F32(2))
        return bounced

    def labels(
        self, intrinsics: np.ndarray, world_from_cam: np.ndarray, height: int, width: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """z-depth in metres and instance ids through the pixel centres."""
        hits = self.tracer.trace(*camera_rays(intrinsics, world_from_cam, height, width))
        hit = hits.face >= 0
        depth = np.where(hit, hits.distance, 0).reshape(height, width)
        instance = np.where(hit, self.mesh.face_instance[hits.face], 0)
        return depth.astype(F32), instance.reshape(height, width).astype(np.uint16)

    def render(
        self,
        intrinsics: Float[np.ndarray, "3 3"],
        world_from_cam: Float[np.ndarray, "4 4"],
        height: int,
        width: int,
        rng: np.random.Generator,
    ) -> Frame:
        """One view: 2x2 samples a pixel and denoising, or 4x4 samples without a denoiser."""
        grid = 2 if self.denoiser else 4
        count = height * width
        diffuse, glow, albedos, normals = (np.zeros((count, 3), F32) for _ in range(4))
        for number in range(grid * grid):
            x, y = (number % grid + 0.5) / grid, (number // grid + 0.5) / grid
            origins, directions = camera_rays(intrinsics, world_from_cam, height, width, (x, y))
            hits = self.tracer.trace(origins, directions)
            face = np.maximum(hits.face, 0)
            surface = self._surface(origins, directions, face, hits.u, hits.v, hits.distance)
            directions /= np.sqrt(_dot(directions, directions))[:, None]
            cosine = np.maximum(-_dot(surface.normals, directions), F32(0.15))
            pixel_m = hits.distance / F32(intrinsics[0, 0] * grid)
            albedo = self._albedo(surface, pixel_m / np.sqrt(cosine))
            light = albedo * self._direct(rng, surface.points, surface.normals)
            if number % grid == (number // grid) % grid:  # bounce a diagonal of the samples
                light += F32(grid) * self._bounced(rng, surface, directions, albedo)
            shining = self.lights.emission[surface.materials] > 0
            light[shining] = 0
            diffuse += light
            glow += albedo * self.lights.visible[surface.materials][:, None]
            albedos += albedo
            normals += surface.normals
        share, shape = F32(1 / grid**2), (height, width, 3)
        diffuse, glow, albedos, normals = (
            (a * share).reshape(shape) for a in (diffuse, glow, albedos, normals)
        )
        if self.denoiser:  # light sources are exact already: add them afterwards
            diffuse = self.denoiser(diffuse, albedos, normals)
        depth, instances = self.labels(intrinsics, world_from_cam, height, width)
        return Frame(diffuse + glow, depth, instances)


def _unit_sphere(rng: np.random.Generator, count: int) -> Rays:
    """Directions uniform on the sphere."""
    z, turn = rng.random((2, count), F32)
    z = 2 * z - 1
    turn *= F32(2 * np.pi)
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], 1)


def white_balance(room: Room, rng: np.random.Generator) -> Float[np.ndarray, " 3"]:
    """Gains of a camera that takes one of the room's lights for white, or something between."""
    sources = [m for m in room.mesh.materials if m.light in ("lamp", "window") and m.emission > 0]
    first, second = (sources[int(rng.integers(len(sources)))] for _ in range(2))
    mixed, share = rng.random(), rng.uniform(0.65, 1.0)
    a, b = (LINEAR[m.texture[::8, ::8]].mean((0, 1)) for m in (first, second))
    seen = a / a.mean() * (1 - mixed) + b / b.mean() * mixed
    gains = seen**-share * np.exp(rng.normal(0, 0.03, 3))
    return (gains / gains.mean()).astype(F32)


def mean_exposure(frames: list[Frame]) -> float:
    """Automatic exposure of a scene: brings the median frame's log-mean radiance to a grey."""
    levels = [np.exp(np.log(f.radiance.mean(-1) + 1e-3).mean()) for f in frames]
    return float(0.23 / (np.median(levels) + 1e-6))
