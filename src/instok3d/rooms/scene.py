"""One scene from one seed: the room, its frames, and what is known of them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8, UInt16

from instok3d.rooms.camera_path import FRAMES, PathFinder, intrinsics_of
from instok3d.rooms.catalogues.opened import NO_CATALOGUES, Catalogues
from instok3d.rooms.denoising import Denoiser
from instok3d.rooms.mesh import attributes
from instok3d.rooms.rendering import Frame, Renderer, mean_exposure, white_balance
from instok3d.rooms.room import Room, build_room
from instok3d.rooms.seeding import GENERATOR_VERSION, Streams, split_of
from instok3d.rooms.sensor import Sensor, developed, exposure_for


@dataclass(frozen=True)
class RenderedScene:
    """A scene as it is stored: 16 frames of one room."""

    images: UInt8[np.ndarray, "frame height width 3"]
    instances: UInt16[np.ndarray, "frame height width"]
    depths_mm: UInt16[np.ndarray, "frame height width"]
    world_from_cam: Float[np.ndarray, "frame 4 4"]
    intrinsics: Float[np.ndarray, "frame 3 3"]
    meta: dict[str, Any]


def render_scene(
    seed: int,
    resolution: int = 128,
    level: str = "mix",
    denoiser: Denoiser | None = None,
    catalogues: Catalogues = NO_CATALOGUES,
) -> RenderedScene | None:
    """The scene of a seed, or None where no camera path shows enough of it or nothing lights it.

    Raises:
        ModuleNotFoundError: The ray tracer is not installed.
        ValueError: The seed or the level does not exist.
    """
    streams = Streams(seed)
    room = build_room(seed, level, catalogues)
    if not any(material.emission > 0 for material in room.mesh.materials):
        return None
    renderer = Renderer(room, streams.child("lights"), denoiser)
    path = PathFinder(room, renderer, streams.child("path")).find()
    if path is None:
        return None
    camera = intrinsics_of(resolution, path.fov_deg)
    frames = [
        renderer.render(camera, pose, resolution, resolution, streams.child("samples", i))
        for i, pose in enumerate(path.poses)
    ]
    images, exposure = developed_frames(room, frames, streams, metered=frames)
    instances = np.stack([f.instances for f in frames])
    records = attributes(room.plan.placed, room.mesh)
    pixels = np.stack([np.bincount(i.ravel(), minlength=len(records) + 1) for i in instances], 1)
    for record in records:
        record["pixels"] = pixels[record["id"]].tolist()
    meta = {
        "seed": seed, "split": split_of(seed), "generator_version": GENERATOR_VERSION,
        "level": room.level.name, "room_type": room.room_type,
        "room_size_m": [round(s, 3) for s in (room.plan.width, room.plan.depth, room.plan.height)],
        "path": path.kind, "fov_deg": round(path.fov_deg, 3),
        "overlaps": [round(o, 3) for o in path.overlaps], "exposure": round(exposure, 4),
        "instances": [r for r in records if any(r["pixels"])],
    }  # fmt: skip
    depths = np.stack([f.depth_m for f in frames])
    return RenderedScene(
        images,
        instances,
        np.minimum(depths * 1000 + 0.5, 65535).astype(np.uint16),
        np.stack(path.poses).astype(np.float32),
        np.tile(camera.astype(np.float32), (FRAMES, 1, 1)),
        meta,
    )


def developed_frames(
    room: Room, frames: list[Frame], streams: Streams, *, metered: list[Frame]
) -> tuple[UInt8[np.ndarray, "frame height width 3"], float]:
    """Pictures with one exposure for the scene, drifting in hard rooms, and a sensor's faults.

    Args:
        room: That the frames show.
        frames: What is developed.
        streams: Of the room's seed.
        metered: The frames that the exposure is found by: the same ones, or those of the room
            before something in it was changed.

    Returns:
        The pictures, and the exposure before any drift.
    """
    rng, level = streams.child("exposure"), room.level
    radiance, contrast = [f.radiance for f in frames], 0.0
    light = [f.radiance for f in metered]
    if level.white_balance:
        gains = white_balance(room, rng)
        radiance, light = ([r * gains for r in each] for each in (radiance, light))
    if level.mean_luma:
        contrast = float(rng.uniform(*level.contrast))
        coarse = np.stack([r[::4, ::4] for r in light])
        exposure = exposure_for(coarse, float(rng.triangular(*level.mean_luma)), contrast)
    else:
        exposure = mean_exposure(metered) * 2 ** float(rng.uniform(*level.exposure_stops))
    phase, speed = rng.uniform(0, 2 * np.pi), rng.uniform(0.15, 0.5)
    drift = level.drift_stops * np.sin(phase + speed * np.arange(len(frames)))
    images = [
        developed(r, exposure * 2 ** float(d), contrast)
        for r, d in zip(radiance, drift, strict=True)
    ]
    if level.sensor:
        sensor = Sensor.draw(rng)
        images = [sensor.apply(image, rng) for image in images]
    return np.stack(images), exposure
