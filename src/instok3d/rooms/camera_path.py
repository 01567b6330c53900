"""Hand-held camera paths through a room, and the choice of frames along them by overlap."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator

from instok3d.rooms.rendering import Renderer, camera_rays
from instok3d.rooms.room import Room

FRAMES = 16
"""Frames of a scene."""
OVERLAP = (0.55, 0.8)
"""Bounds of the overlap between frames i and i + 2: the mean of both directions."""
PROBE = 64
"""Pixels of the views in which overlap is measured."""
SEGMENTS, DENSE, TRIES = 5, 26, 16
"""Pieces of a path, candidate frames on each, and paths that are tried."""

Pose = Float[np.ndarray, "4 4"]


def looking(eye: np.ndarray, yaw_rad: float, pitch_rad: float, roll_rad: float) -> Pose:
    """world_from_cam in OpenCV axes, z of the world up."""
    flat = np.array([np.cos(yaw_rad), np.sin(yaw_rad), 0.0])
    forward = np.cos(pitch_rad) * flat + [0, 0, np.sin(pitch_rad)]
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([c * right + s * down, c * down - s * right, forward], 1)
    pose[:3, 3] = eye
    return pose


def intrinsics_of(size: int, fov_deg: float) -> Float[np.ndarray, "3 3"]:
    """A square pinhole camera."""
    focal = 0.5 * size / np.tan(np.radians(fov_deg) / 2)
    return np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])


@dataclass(frozen=True)
class Probe:
    """What a candidate frame sees at low resolution."""

    pose: Pose
    points: Float[np.ndarray, "pixel 3"]
    depth_m: Float[np.ndarray, "height width"]
    good: bool
    """Worth a frame: not too near, enough objects, not mostly walls or one object."""


@dataclass(frozen=True)
class CameraPath:
    """The frames of a scene."""

    poses: list[Pose]
    fov_deg: float
    overlaps: list[float]
    """Between frames i and i + 2."""
    kind: str
    """focus (around a point), roam (from object to object) or pan (turning)."""


class PathFinder:
    """Draws paths until one gives enough frames."""

    def __init__(self, room: Room, renderer: Renderer, rng: np.random.Generator):
        self.room, self.renderer, self.rng = room, renderer, rng
        self.level = room.level
        self.fov_deg = self.level.draw_fov_deg(rng)
        self.intrinsics = intrinsics_of(PROBE, self.fov_deg)
        plan = room.plan
        self.obstacles = [b for b in plan.obstacles.values() if b.high > 0.3 and b.low < 1.9]
        self.targets = [
            np.array([b.x, b.y]) for k, b in plan.obstacles.items() if k > 0 and b.low < 1
        ]
        self.center = np.array([plan.width, plan.depth]) / 2
        names = [p.furniture.name for p in plan.placed]
        self.stuff = np.array([True, *(n in ("wall", "floor", "ceiling") for n in names)])

    def find(self) -> CameraPath | None:
        """A path whose frames overlap as wanted, or None if no path does."""
        for _ in range(TRIES):
            poses, kind = self._draw_path()
            probes = [p for p in (self._probe(pose) for pose in poses) if p.good]
            for start in (0, len(probes) // 4, len(probes) // 2):
                if len(probes) - start < FRAMES:
                    break
                chosen, overlaps = self._choose(probes[start:])
                if len(chosen) == FRAMES:
                    return CameraPath([p.pose for p in chosen], self.fov_deg, overlaps, kind)
        return None

    def _free(self, point: np.ndarray, clearance: float) -> bool:
        plan = self.room.plan
        inside = (point > 0.35).all() and (point < [plan.width - 0.35, plan.depth - 0.35]).all()
        return bool(inside) and all(b.distance(point) > clearance for b in self.obstacles)

    def _free_point(self) -> np.ndarray:
        plan = self.room.plan
        for clearance in (0.35, 0.25, 0.15, 0.05):
            for _ in range(60):
                point = self.rng.uniform([0.35, 0.35], [plan.width - 0.35, plan.depth - 0.35])
                if self._free(point, clearance):
                    return point
        return self.center

    def _waypoints(self) -> np.ndarray:
        """Points on the floor that can be walked to one after the other."""
        points = [self._free_point()]
        for _ in range(SEGMENTS):
            here = points[-1]
            there = here + self.rng.normal(0, 0.12, 2)
            if not self._free(there, 0.1):
                there = here
            for _ in range(25):
                goal = self._free_point()
                steps = [here + (goal - here) * t for t in (0.25, 0.5, 0.75)]
                far = 0.4 < np.linalg.norm(goal - here) < 2.0
                if far and all(self._free(step, 0.12) for step in steps):
                    there = goal
                    break
            points.append(there)
        return np.array(points)

    def _aim(
        self, point: np.ndarray, focus: np.ndarray | None, targets: list[np.ndarray]
    ) -> np.ndarray:
        """The way from a point to near the focus, or else to near a target; > 0.9 m if it can."""
        away = np.zeros(2)
        for _ in range(20):
            target = targets[self.rng.integers(len(targets))] if focus is None else focus
            away = target + self.rng.normal(0, 0.33, 2) - point
            if np.linalg.norm(away) > 0.9:
                break
        return away

    def _draw_path(self) -> tuple[list[Pose], str]:
        """A hand-held path through way-points, as dense poses, and its kind."""
        rng, points = self.rng, self._waypoints()
        kind = str(rng.choice(["focus", "roam", "pan"], p=[0.35, 0.4, 0.25]))
        heights = rng.uniform(*self.level.height_m) + rng.normal(0, 0.08, len(points))
        targets = [*self.targets, self.center, self.center]
        focus = 0.5 * (targets[rng.integers(len(targets))] + self.center)
        turning = rng.choice([-1, 1])
        yaws, pitches = [], []
        for point, height in zip(points, heights, strict=True):
            away = self._aim(point, focus if kind == "focus" else None, targets)
            yaw = float(np.arctan2(away[1], away[0]))
            if kind == "pan" and yaws:
                yaw = yaws[-1] + turning * rng.uniform(0.5, 1.1)
            if yaws:  # the short way round
                yaw = yaws[-1] + (yaw - yaws[-1] + np.pi) % (2 * np.pi) - np.pi
            yaws.append(yaw)
            drop = height - rng.uniform(0.3, 1.1)
            pitches.append(np.clip(-np.arctan2(drop, max(np.linalg.norm(away), 1.4)), -0.7, 0.05))
        return self._walk(points, heights, yaws, pitches), kind

    def _walk(self, points: np.ndarray, *knots: Sequence[float] | np.ndarray) -> list[Pose]:
        """Smooth poses through way-points and their heights, yaws, pitches, with a tremor."""
        t = np.linspace(0, SEGMENTS, SEGMENTS * DENSE + 1)
        tilt = self.level.tilt
        tremor = [
            a * np.sin(t * f + self.rng.uniform(0, 6))
            for a, f in ((0.015, 7), (0.02, 5), (0.02 * tilt, 6), (0.03 * tilt, 3))
        ]
        xy, z, yaw, pitch = (
            PchipInterpolator(np.arange(SEGMENTS + 1), values)(t) for values in (points, *knots)
        )
        eyes = np.column_stack([xy, z + tremor[0]])
        angles = yaw + tremor[1], pitch + tremor[2], tremor[3]
        return [looking(*frame) for frame in zip(eyes, *angles, strict=True)]

    def _probe(self, pose: Pose) -> Probe:
        origins, directions = camera_rays(self.intrinsics, pose, PROBE, PROBE)
        hits = self.renderer.tracer.trace(origins, directions)
        hit = hits.face >= 0
        instance = np.where(hit, self.renderer.mesh.face_instance[hits.face], 0)
        pixels = np.bincount(instance, minlength=len(self.stuff))
        objects, total = pixels[~self.stuff], len(instance)
        distance = np.where(hit, hits.distance, 0)
        good = bool(
            hit.mean() > 0.999
            and np.median(distance) > self.level.near_m
            and (distance < 0.55).mean() < self.level.near_share
            and (objects >= 20).sum() >= 3
            and objects.max() < 0.6 * total
            and objects.sum() > 0.15 * total
        )
        points = origins + directions * distance[:, None]
        return Probe(pose, points, distance.reshape(PROBE, PROBE), good)

    def overlap(self, first: Probe, second: Probe) -> float:
        """Share of what one view sees that the other sees too; the mean of both directions."""
        return 0.5 * (self._seen(first, second) + self._seen(second, first))

    def _seen(self, source: Probe, other: Probe) -> float:
        rotation, eye = other.pose[:3, :3].astype(np.float32), other.pose[:3, 3].astype(np.float32)
        points = (source.points - eye) @ rotation
        z = np.maximum(points[:, 2], 1e-3)
        pixel = np.floor(points[:, :2] * (self.intrinsics[0, 0] / z)[:, None] + PROBE / 2)
        inside = (points[:, 2] > 0.05) & (pixel >= 0).all(1) & (pixel < PROBE).all(1)
        x, y = pixel[inside].astype(np.int32).T
        agrees = np.abs(other.depth_m[y, x] - z[inside]) < 0.04 * z[inside] + 0.03
        return float(agrees.sum() / len(points))

    def _choose(self, probes: list[Probe]) -> tuple[list[Probe], list[float]]:
        """Walk along the path; each frame is as far on as the overlap two frames back allows."""
        low, high = OVERLAP
        chosen, overlaps, last = [probes[0]], [], 0
        while len(chosen) < FRAMES:
            wanted = float(self.rng.uniform(0.78, 0.88))
            best: tuple[float, int, float] | None = None
            for j in range(last + 1, len(probes)):
                near = self.overlap(chosen[-1], probes[j])
                two = self.overlap(chosen[-2], probes[j]) if len(chosen) > 1 else near - 0.08
                if two < low or near < low:
                    break
                if two <= high or len(chosen) == 1:
                    miss = abs(near - wanted)
                    if best is None or miss < best[0]:
                        best = (miss, j, two)
                    if near < wanted:
                        break
            if best is None:
                break
            if len(chosen) > 1:
                overlaps.append(best[2])
            last = best[1]
            chosen.append(probes[last])
        return chosen, overlaps
