"""What `instok3d diff` says of rooms in which one thing moved, one is gone and one is new.

    python benchmarks/changes.py [--rooms 10] [--first-seed 2000000] [--photos 2] [--refine 0]
        [--unchanged] [--show]

Each room is rendered twice, at frames 2 and 4 before and 3 and 5 after (of four photos at 6 and 8
and at 7 and 9 too), the light left alone. What changes is no lamp, carries nothing and shows 150
pixels in each capture that has it; what moves stands on the floor, and goes 0.5 to 1.2 m to where
nothing stands. Both captures are reconstructed from the bare photos. An object is the thing that
has most of its pixels.

- precision: of the objects that are said to have moved, to be gone or to be new, those that did
- recall: of the changed things, those of which an object is said to have changed so
- shown: of the changed things, those that an object is there of, in each capture that has them:
  what recall could be with these groups

With --unchanged both captures show the room before, and all that is told is wrong.
"""

import argparse
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from PIL import Image

import instok3d
from instok3d.rooms.camera_path import PathFinder, intrinsics_of
from instok3d.rooms.classes import STUFF
from instok3d.rooms.denoising import find_denoiser
from instok3d.rooms.mesh import Mesh
from instok3d.rooms.rendering import Frame, Renderer
from instok3d.rooms.room import Room, build_room
from instok3d.rooms.scene import developed_frames
from instok3d.rooms.seeding import Streams
from instok3d.rooms.tracing import EmbreeTracer, Hits, Rays
from instok3d.scene.changes.differences import find_differences
from instok3d.scene.changes.record import Difference
from instok3d.scene.scene import Scene

FRAMES = {2: ((2, 4), (3, 5)), 4: ((2, 4, 6, 8), (3, 5, 7, 9))}
"""Before and after, by the number of photos."""
SIDE, MIN_PIXELS = 128, 150
STEPS_M, TURNS = (0.5, 0.7, 0.9, 1.2), 12
KINDS = ("moved", "gone", "new")


@dataclass(frozen=True)
class Changes:
    """Instance ids of what changed, and the way of what moved."""

    moved: int
    gone: int
    new: int
    by: Float[np.ndarray, "3"]


class ChangedRoom:
    """The tracer of a room without an instance, another one of which may have moved."""

    def __init__(self, mesh: Mesh, without: int, moved: int = 0, by: np.ndarray | None = None):
        self.kept = np.flatnonzero(mesh.face_instance != without)
        vertices = mesh.vertices.copy()
        if by is not None:
            vertices[np.unique(mesh.faces[mesh.face_instance == moved])] += by.astype(np.float32)
        self.tracer = EmbreeTracer(vertices, mesh.faces[self.kept])

    def trace(self, origins: Rays, directions: Rays) -> Hits:
        """As of a `Tracer`; faces are those of the whole room."""
        found = self.tracer.trace(origins, directions)
        face = np.where(found.face >= 0, self.kept[found.face], -1)
        return Hits(face, found.u, found.v, found.distance)

    def occluded(self, origins: Rays, directions: Rays, distances: np.ndarray) -> np.ndarray:
        """As of a `Tracer`."""
        return self.tracer.occluded(origins, directions, distances)


@dataclass(frozen=True)
class Capture:
    """A scene of a few photos, and the true instance of each of its objects, 0 for none."""

    scene: Scene
    thing_of: dict[int, int]


class Pair:
    """A room before and after."""

    def __init__(self, seed: int, refine: int, photos: int) -> None:
        """Render and reconstruct both; `changes` is None where nothing in the room can change."""
        self.streams, self.refine = Streams(seed), refine
        self.frames = FRAMES[photos]
        self.room = build_room(seed)
        self.renderer = Renderer(self.room, self.streams.child("lights"), find_denoiser())
        path = PathFinder(self.room, self.renderer, self.streams.child("path")).find()
        assert path is not None  # test rooms that have none are not asked for
        self.poses, self.camera = path.poses, intrinsics_of(SIDE, path.fov_deg)
        self.changes = self._drawn(np.random.default_rng(seed))

    def captures(self, *, unchanged: bool = False) -> tuple[Capture, Capture]:
        """Before and after; or both before, from the two places."""
        assert self.changes is not None
        one, mesh = self.changes, self.room.mesh
        old = ChangedRoom(mesh, one.new)
        new = old if unchanged else ChangedRoom(mesh, one.gone, one.moved, one.by)
        return self._captured(old, self.frames[0]), self._captured(new, self.frames[1])

    def _drawn(self, rng: np.random.Generator) -> Changes | None:
        """Three things that are seen well; what moves is still seen where it went."""
        whole = self.renderer.tracer
        seen = [self._pixels(whole, frames) for frames in self.frames]
        boxes = boxes_of(self.room)
        fit = [each for each in free_things(self.room)
               if min(count[each] for count in seen) >= MIN_PIXELS]  # fmt: skip
        rng.shuffle(fit)
        for moved in fit:
            for by in ways(moved, boxes, self.room, rng):
                after = self._pixels(ChangedRoom(self.room.mesh, 0, moved, by), self.frames[1])
                others = [each for each in fit if each != moved]
                others = [each for each in others if after[each] >= MIN_PIXELS]
                if after[moved] >= MIN_PIXELS and len(others) >= 2:
                    return Changes(moved, others[0], others[1], by)
        return None

    def _pixels(self, tracer, frames: Sequence[int]) -> Int[np.ndarray, " instance"]:
        whole, self.renderer.tracer = self.renderer.tracer, tracer
        ids = [
            self.renderer.labels(self.camera, self.poses[each], SIDE, SIDE)[1] for each in frames
        ]
        self.renderer.tracer = whole
        return np.bincount(np.stack(ids).ravel(), minlength=len(self.room.plan.placed) + 1)

    def _captured(self, tracer: ChangedRoom, frames: Sequence[int]) -> Capture:
        whole, self.renderer.tracer = self.renderer.tracer, tracer
        shots: list[Frame] = [
            self.renderer.render(
                self.camera, self.poses[each], SIDE, SIDE, self.streams.child("samples", each)
            )
            for each in frames
        ]
        self.renderer.tracer = whole
        images, _ = developed_frames(self.room, shots, self.streams, metered=shots)
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for index, image in enumerate(images):
                Image.fromarray(image).save(f"{folder}/{index}.png")
            scene = instok3d.reconstruct(Path(folder), refine=self.refine)
        ids = scene.render(ids=True).ids
        assert ids is not None
        truth = torch.from_numpy(np.stack([shot.instances for shot in shots]).astype(np.int64))
        things = {}
        for item in scene.objects:
            won = truth[ids == item.id]
            things[item.id] = int(won.mode().values) if len(won) else 0
        return Capture(scene, things)


def free_things(room: Room) -> list[int]:
    """Instances that are no surfaces or lamps, and carry nothing."""
    mesh, placed = room.mesh, room.plan.placed
    lit = {number for number, each in enumerate(mesh.materials) if each.emission > 0}
    shining = {int(one) for one, kind in zip(mesh.face_instance, mesh.face_material, strict=True)
               if int(kind) in lit}  # fmt: skip
    carrying = {each.parent for each in placed}
    return [
        number for number, each in enumerate(placed, 1)
        if each.furniture.name not in (*STUFF, "window", "door")
        and number not in shining and number not in carrying
    ]  # fmt: skip


def boxes_of(room: Room) -> Float[np.ndarray, "instance 2 3"]:
    """Least and most coordinates of each instance; row 0 is of none."""
    mesh = room.mesh
    boxes = np.zeros((len(room.plan.placed) + 1, 2, 3))
    for number in range(1, len(boxes)):
        corners = mesh.vertices[np.unique(mesh.faces[mesh.face_instance == number])]
        boxes[number] = corners.min(axis=0), corners.max(axis=0)
    return boxes


def ways(
    moved: int, boxes: Float[np.ndarray, "instance 2 3"], room: Room, rng: np.random.Generator
) -> Iterator[Float[np.ndarray, "3"]]:
    """Ways on the floor to where nothing stands; none of what does not stand on the floor."""
    low, high = boxes[moved]
    if low[2] > 0.03:
        return
    plan, names = room.plan, [each.furniture.name for each in room.plan.placed]
    others = [number for number in range(1, len(boxes))
              if number != moved and names[number - 1] not in (*STUFF, "rug")]  # fmt: skip
    start = rng.uniform(0, 2 * np.pi)
    for step in STEPS_M:
        for angle in start + 2 * np.pi * np.arange(TURNS) / TURNS:
            by = np.array([step * np.cos(angle), step * np.sin(angle), 0.0])
            first, last = low + by, high + by
            inside = (first[:2] > 0.05).all() and last[0] < plan.width - 0.05
            if not inside or last[1] > plan.depth - 0.05:
                continue
            apart = (boxes[others, 1] <= first).any(1) | (boxes[others, 0] >= last).any(1)
            if apart.all():
                yield by


@dataclass
class Counts:
    """Of one kind of change, over pairs."""

    told: int = 0
    right: int = 0
    found: int = 0
    shown: int = 0
    things: int = 0


def count(
    counts: dict[str, Counts],
    changes: Changes,
    before: Capture,
    after: Capture,
    found: Difference | None,
) -> None:
    """Add one pair; without a difference the captures could not be aligned."""
    for kind in KINDS:
        into, thing = counts[kind], getattr(changes, kind)
        captures = {"moved": (before, after), "gone": (before,), "new": (after,)}[kind]
        into.things += 1
        into.shown += all(thing in each.thing_of.values() for each in captures)
        told = [] if found is None else found.of_kind(kind)
        side = "after" if kind == "new" else "before"
        things = [captures[0].thing_of[getattr(each, side).id] for each in told]
        into.told += len(things)
        into.right += things.count(thing)
        into.found += thing in things


def table(counts: dict[str, Counts]) -> str:
    """Markdown, a row for each kind."""
    lines = ["| change | told | precision | things | recall | shown |", "|---|---|---|---|---|---|"]
    for kind, each in counts.items():
        precision = f"{each.right / each.told:.2f}" if each.told else "-"
        recall, shown = (value / max(each.things, 1) for value in (each.found, each.shown))
        lines.append(
            f"| {kind} | {each.told} | {precision} | {each.things} | {recall:.2f} | {shown:.2f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--rooms", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=2_000_000)
    parser.add_argument("--photos", type=int, default=2, choices=sorted(FRAMES))
    parser.add_argument("--refine", type=int, default=0)
    parser.add_argument("--unchanged", action="store_true", help="show the room before twice")
    parser.add_argument("--show", action="store_true", help="print what diff says of each pair")
    given = parser.parse_args()
    counts = {kind: Counts() for kind in KINDS}
    seed, done, apart = given.first_seed, 0, 0
    while done < given.rooms:
        pair = Pair(seed, given.refine, given.photos)
        seed += 1
        if pair.changes is None:
            continue
        done += 1
        before, after = pair.captures(unchanged=given.unchanged)
        try:
            found = find_differences(before.scene, after.scene)
        except ValueError as reason:
            found, apart = None, apart + 1
            print(f"room {seed - 1}: {reason}", flush=True)
        if given.unchanged:
            for kind in KINDS:
                counts[kind].told += 0 if found is None else len(found.of_kind(kind))
        else:
            count(counts, pair.changes, before, after, found)
        if given.show and found is not None:
            names = [each.furniture.name for each in pair.room.plan.placed]
            true = {kind: names[getattr(pair.changes, kind) - 1] for kind in KINDS}
            print(f"room {seed - 1}: {true}\n{found}\n", flush=True)
    print(table(counts))
    print(f"{done} pairs of seeds {given.first_seed} to {seed - 1}, {apart} could not be aligned")


if __name__ == "__main__":
    with torch.no_grad():
        main()
