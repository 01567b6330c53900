"""Rooms of boxes made by hand: each thing is the surface of a box in small Gaussians. z is up."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch

from instok3d.geometry.moving import Similarity, carry_gaussians
from instok3d.geometry.spherical_harmonics import SH_CONSTANT
from instok3d.photos.pixel_map import fit_pixels
from instok3d.scene.from_gaussians import scene_from_gaussians
from instok3d.scene.paths import look_at
from instok3d.scene.record import Provenance, SceneView
from instok3d.scene.scene import Scene
from instok3d.scene.sight import look
from instok3d.scene.vertical import Vertical
from instok3d.types import Cameras, Gaussians

Point = tuple[float, float, float]
RED, GREEN, BLUE = (0.75, 0.1, 0.1), (0.15, 0.55, 0.15), (0.1, 0.2, 0.75)
WHITE, BROWN, YELLOW = (0.95, 0.95, 0.95), (0.42, 0.25, 0.12), (0.92, 0.83, 0.18)
SIDE = 64
"""Of the pictures of rooms with cameras, pixels."""


@dataclass(frozen=True)
class Thing:
    """A box with a colour."""

    low: Point
    high: Point
    color: Point


OFFICE = {
    "floor": Thing((0, 0, -0.1), (4, 3, 0), BROWN),
    "wall": Thing((0, 3, 0), (4, 3.1, 2.5), WHITE),
    "desk": Thing((0.1, 2.2, 0), (1.7, 3, 0.75), YELLOW),
    "cup": Thing((0.4, 2.4, 0.76), (0.5, 2.5, 0.88), RED),
    "chair": Thing((0.8, 1.5, 0), (1.3, 2.0, 0.9), BLUE),
    "cabinet": Thing((3.2, 2.4, 0), (3.9, 3.0, 1.8), GREEN),
    "box": Thing((2.8, 0.6, 0), (3.3, 1.0, 0.4), RED),
    "stool": Thing((0.4, 0.4, 0), (0.8, 0.8, 0.5), GREEN),
}
"""In metres."""

MOTION = Similarity((0.7, -1.2, 2.0), (0.5, -0.5, 0.1, 0.7), 0.4)
"""Into another world: turned, in units of 2.5 m."""


def box_room(
    things: Mapping[str, Thing],
    *,
    labelled: bool = True,
    each: int = 300,
    seed: int = 0,
    motion: Similarity | None = None,
) -> Scene:
    """Things by name, ids from 1 in their order, up stated, no views.

    Their Gaussians are drawn at random: another seed is as another capture. A motion carries the
    whole room along, into units that nobody knows.
    """
    generator = torch.Generator().manual_seed(seed)
    points, colors, ids = [torch.zeros(0, 3)], [torch.zeros(0, 3)], []
    for number, thing in enumerate(things.values(), 1):
        points.append(_surface(thing, each, generator))
        colors.append(torch.tensor(thing.color).expand(each, 3))
        ids += [number] * each
    count = len(ids)
    gaussians = Gaussians(
        means=torch.cat(points),
        quats=torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),
        scales=torch.full((count, 3), 0.03),
        opacities=torch.full((count,), 0.95),
        sh=(torch.cat(colors) - 0.5)[:, None] / SH_CONSTANT,
        anchor_index=torch.zeros(count, dtype=torch.long),
    )
    up = (0.0, 0.0, 1.0)
    if motion is not None:
        gaussians = carry_gaussians(gaussians, motion)
        x, y, z = motion.rotation()[:, 2].tolist()
        up = (x, y, z)
    names = {number: name for number, name in enumerate(things, 1) if labelled}
    return scene_from_gaussians(
        gaussians, torch.tensor(ids, dtype=torch.long), labels=names, 
        units="metres" if motion is None else "arbitrary",
        provenance=Provenance("instok3d 0", "imported", "", seed=0),
        vertical=Vertical(up, "given", 1.0), height=SIDE, width=SIDE,
    )  # fmt: skip


def with_cameras(scene: Scene, eyes: list[Point], target: Point) -> Scene:
    """The scene with input views from some places, all of which look at one point."""
    places, count = torch.tensor(eyes), len(eyes)
    looks = look_at(places, torch.tensor(target).expand(count, 3), torch.tensor([0.0, 0, -1]))
    one = torch.tensor([[SIDE * 0.7, 0, SIDE / 2], [0, SIDE * 0.7, SIDE / 2], [0, 0, 1]])
    seen = replace(
        scene,
        cameras=Cameras(looks, one.repeat(count, 1, 1)),
        photos=torch.zeros(count, SIDE, SIDE, 3, dtype=torch.uint8),
        views=tuple(SceneView(f"{number}.png", f"{number:064x}", fit_pixels(SIDE, SIDE, SIDE, SIDE))
                    for number in range(count)),
    )  # fmt: skip
    found = look(seen)
    objects = [replace(item, sight=found.of_group(item.id - 1)) for item in seen.objects]
    return replace(seen, objects=tuple(objects))


def _surface(thing: Thing, count: int, generator: torch.Generator) -> torch.Tensor:
    """Points on the faces of a box, by their areas."""
    low, high = torch.tensor([thing.low, thing.high], dtype=torch.float32)
    size = high - low
    areas = torch.stack([size[1] * size[2], size[0] * size[2], size[0] * size[1]])
    axis = torch.multinomial(areas, count, replacement=True, generator=generator)
    points = low + size * torch.rand(count, 3, generator=generator)
    ends = torch.where(torch.rand(count, generator=generator) < 0.5, low[axis], high[axis])
    return points.scatter(1, axis[:, None], ends[:, None])
