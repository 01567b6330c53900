"""What is left where an object was removed, against rooms rendered without it.

    python benchmarks/removals.py --data rooms-test [--rooms 8] [--sheet sheet.png]

Every fifth test room, photos 2 and 4, reconstructed and refined; objects of 150 pixels to a quarter
of both photos that a found object overlaps with IoU >= .5. Shares are of the object's true pixels:

- ghost: within .12 of the photo, where the room without the object is not
- hole: transmittance above 1/2
- outside: pixels outside of the object that change by more than .1
- PSNR: of the object's pixels, against the room without the object

The room keeps lights and exposure when it loses an object; what stood on it stays in the air.
"""

import argparse
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from PIL import Image
from torch import Tensor

import instok3d
from instok3d.pictures import Section, color_picture, contact_sheet
from instok3d.rooms.camera_path import PathFinder, intrinsics_of
from instok3d.rooms.catalogues.opened import NO_CATALOGUES
from instok3d.rooms.dataset import RoomDataset
from instok3d.rooms.denoising import find_denoiser
from instok3d.rooms.mesh import Mesh
from instok3d.rooms.rendering import Renderer
from instok3d.rooms.room import build_room
from instok3d.rooms.scene import developed_frames
from instok3d.rooms.seeding import Streams
from instok3d.rooms.tracing import EmbreeTracer, Hits, Rays
from instok3d.scene.scene import Scene

FRAMES, STEP = (2, 4), 5
MIN_PIXELS, MAX_SHARE, MIN_IOU = 150, 0.25, 0.5
STUFF = ("wall", "floor", "ceiling", "window", "door")
SAME, CHANGED = 0.12, 0.1
COLUMNS = ("ghost", "hole", "outside", "PSNR")
WAYS = {"nothing": {}, "claim": {"claim": True}, "claim, fill": {"claim": True, "fill": "plane"}}


class Without:
    """The tracer of a room in which some instances are not."""

    def __init__(self, mesh: Mesh, gone: int) -> None:
        self.kept = np.flatnonzero(mesh.face_instance != gone)
        self.tracer = EmbreeTracer(mesh.vertices, mesh.faces[self.kept])

    def trace(self, origins: Rays, directions: Rays) -> Hits:
        """As of a `Tracer`; faces are those of the whole room."""
        found = self.tracer.trace(origins, directions)
        face = np.where(found.face >= 0, self.kept[found.face], -1)
        return Hits(face, found.u, found.v, found.distance)

    def occluded(self, origins: Rays, directions: Rays, distances: np.ndarray) -> np.ndarray:
        """As of a `Tracer`."""
        return self.tracer.occluded(origins, directions, distances)


class EmptiedRoom:
    """The room of a seed, rendered with and without its objects."""

    def __init__(self, seed: int, resolution: int) -> None:
        self.streams = Streams(seed)
        self.room = build_room(seed, "mix", NO_CATALOGUES)
        self.renderer = Renderer(self.room, self.streams.child("lights"), find_denoiser())
        path = PathFinder(self.room, self.renderer, self.streams.child("path")).find()
        assert path is not None  # the room is in the data set
        self.poses, self.side = path.poses, resolution
        self.camera = intrinsics_of(resolution, path.fov_deg)
        self.frames = [self._frame(index) for index in range(len(self.poses))]

    def without(self, gone: int) -> Float[Tensor, "view 3 height width"]:
        """The photos without an instance."""
        whole, frames = self.renderer.tracer, list(self.frames)
        self.renderer.tracer = Without(self.room.mesh, gone)
        for index in FRAMES:
            frames[index] = self._frame(index)
        self.renderer.tracer = whole
        images, _ = developed_frames(self.room, frames, self.streams, metered=self.frames)
        return as_floats(torch.from_numpy(images[list(FRAMES)]))

    def _frame(self, index: int):
        rng = self.streams.child("samples", index)
        return self.renderer.render(self.camera, self.poses[index], self.side, self.side, rng)


@dataclass(frozen=True)
class Case:
    """One object to be removed."""

    scene: Scene
    found: int
    kind: str
    mask: Bool[Tensor, "view height width"]
    photos: Float[Tensor, "view 3 height width"]
    truth: Float[Tensor, "view 3 height width"]


def as_floats(images: Tensor) -> Float[Tensor, "view 3 height width"]:
    """Bytes, channels last, as sRGB in [0, 1]."""
    return images.permute(0, 3, 1, 2).float() / 255


def cases(data: RoomDataset, rooms: int) -> Iterator[Case]:
    """All objects of some rooms that are found well enough."""
    for number in range(0, STEP * rooms, STEP):
        frames, meta = data.frames(number, FRAMES), data.scene(number).meta
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for index, image in enumerate(frames.images):
                Image.fromarray(image.numpy()).save(f"{folder}/{index}.png")
            scene = instok3d.reconstruct(Path(folder))
        ids, empty = scene.render(ids=True).ids, EmptiedRoom(data.seed_of(number), data.resolution)
        assert ids is not None
        kinds = {each["id"]: each["class"] for each in meta["instances"]}
        for true in frames.instances.unique().tolist():
            mask = frames.instances == true
            if true > 0 and MIN_PIXELS <= int(mask.sum()) <= MAX_SHARE * mask.numel():
                iou, found = max((overlap(ids == item.id, mask), item.id) for item in scene.objects)
                if iou >= MIN_IOU:
                    photos = as_floats(frames.images)
                    yield Case(scene, found, kinds[true], mask, photos, empty.without(true))


def overlap(first: Tensor, second: Tensor) -> float:
    """IoU of two masks."""
    return float((first & second).sum() / (first | second).sum())


def measured(case: Case, edited: Scene) -> list[float]:
    """Ghost, hole, outside, PSNR of one removal."""
    before, after, mask = case.scene.render(), edited.render(), case.mask
    colors = after.colors.clamp(0, 1)
    same = (colors - case.photos).abs().amax(1) < SAME
    ghost = same & ((case.truth - case.photos).abs().amax(1) >= SAME) & (after.alphas > 0.5)
    changed = (after.colors - before.colors).abs().amax(1) > CHANGED
    square = ((colors - case.truth) ** 2).mean(1)[mask].mean()
    counts = [(ghost & mask).sum(), ((after.alphas < 0.5) & mask).sum(), (changed & ~mask).sum()]
    return [*(float(each / mask.sum()) for each in counts), float(-10 * square.log10())]


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--rooms", type=int, default=8)
    parser.add_argument("--sheet", type=Path)
    options = parser.parse_args()
    rows: list[tuple[bool, list[list[float]]]] = []
    times_s, pictures = [], []
    for case in cases(RoomDataset(options.data), options.rooms):
        shots, values, took_s = [case.photos], [], 0.0
        for way in WAYS.values():
            start = time.perf_counter()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                edited = case.scene.remove(case.found, **way)
            took_s = time.perf_counter() - start
            values.append(measured(case, edited))
            shots.append(edited.render().colors)
        times_s.append(took_s)
        rows.append((case.kind in STUFF, values))
        shots.append(case.truth)
        pictures += [Section(case.kind, [color_picture(shot[0]) for shot in shots])]
    for name, chosen in {
        "all": [values for _, values in rows],
        "without walls, floors, ceilings, windows, doors": [v for stuff, v in rows if not stuff],
    }.items():
        print(f"\n{len(chosen)} objects, {name}")
        print(f"{'':14}" + "".join(f"{title:>8}" for title in COLUMNS))
        for way, means in zip(WAYS, np.mean(chosen, axis=0), strict=True):
            print(f"{way:14}" + "".join(f"{value:8.3f}" for value in means))
    print(f"\nremove with claim and fill: {np.mean(times_s):.2f} s, at most {max(times_s):.2f} s")
    if options.sheet is not None:
        contact_sheet(pictures).save(options.sheet)
    return 0


if __name__ == "__main__":
    sys.exit(main())
