"""Pictures of edits in the manner of the paper's Fig. 5: before, alone, removed, moved, inserted.

python docs/pictures/edits.py

writes demo.jpg (the demo, from photos alone) and edits.jpg (two test rooms, cameras given) into
this folder.

python docs/pictures/edits.py CAPTURE FILE

writes the same of a capture of a real room with its cameras, a folder such as the red kitchen of
7-Scenes, into FILE. Needs the extra `rooms`: what is inserted comes from the test rooms.
"""

import sys
import tempfile
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import UInt8
from PIL import Image

import instok3d
from instok3d.files import write_json
from instok3d.geometry.cameras import invert_rigid
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.pictures import Section, color_picture, contact_sheet, id_picture
from instok3d.rooms.denoising import find_denoiser
from instok3d.rooms.scene import render_scene
from instok3d.scene.edits.placing import base_of_object
from instok3d.scene.vertical import Vertical

HERE = Path(__file__).resolve().parent
SIDE = 256
QUALITY = 88
TITLES = ("before", "one object alone", "removed", "moved", "one of another room inserted")
Pixel = tuple[int, int]
"""Row and column of a picture of 128 x 128 pixels."""


@dataclass(frozen=True)
class Handle:
    """An object as a person would point at it: what a view of a scene shows at a pixel."""

    view: int
    pixel: Pixel

    def find(self, scene: instok3d.Scene) -> int:
        """Its id."""
        ids = scene.render([self.view], ids=True).ids
        assert ids is not None
        return int(ids[(0, *self.pixel)])


@dataclass(frozen=True)
class Edits:
    """What is done in one row of a figure; all of it is seen from the view of `taken`."""

    taken: Handle
    """The object that is shown alone, removed and moved."""
    to: Pixel
    """Where the middle of its base is put down when it is moved."""
    brought: Handle
    """An object of the other scene."""
    at: Pixel
    """Where the middle of its base is put down."""
    yaw: float = 0.0
    """Of what is moved, degrees."""
    brought_yaw: float = 0.0
    scale: float | None = None
    """Of what is inserted, where lengths are not metres."""


DEMO = Edits(
    Handle(2, (88, 40)), (110, 96), Handle(3, (64, 64)), (116, 104),
    yaw=-15.0, brought_yaw=-30.0, scale=0.7,
)  # fmt: skip
ROOMS = {
    2000005: Edits(Handle(7, (57, 91)), (92, 92), Handle(7, (68, 58)), (90, 78), brought_yaw=85.0),
    2000008: Edits(
        Handle(7, (68, 58)), (100, 50), Handle(7, (57, 91)), (98, 44), brought_yaw=255.0
    ),
}
KITCHEN = Edits(Handle(1, (85, 100)), (112, 62), Handle(7, (57, 91)), (86, 44), brought_yaw=-135.0)
KITCHEN_FLOOR = Handle(1, (110, 30))


def room_scene(seed: int, *, posed: bool) -> instok3d.Scene:
    """The scene of eight pictures of a test room, with their cameras or without."""
    room = render_scene(seed, 128, denoiser=find_denoiser())
    assert room is not None
    with tempfile.TemporaryDirectory() as name:
        folder, frames = Path(name), []
        for index in range(0, len(room.images), 2):
            Image.fromarray(room.images[index]).save(folder / f"{index:02d}.png")
            pose = room.world_from_cam[index].tolist()
            frames.append({"id": str(index), "color": f"{index:02d}.png", "c2w": pose})
        if not posed:
            return instok3d.reconstruct(folder)
        side, intrinsics = room.images.shape[1], room.intrinsics[0].tolist()
        cameras = {"width": side, "height": side, "K": intrinsics, "frames": frames}
        write_json(folder / "scene.json", cameras)
        return instok3d.reconstruct(folder, cameras=folder / "scene.json")


def point_at(scene: instok3d.Scene, view: int, pixel: Pixel) -> tuple[float, float, float]:
    """The point of the scene, in its world, that a view shows at a pixel."""
    row, column = pixel
    depth = float(scene.render([view]).depths[0, row, column])
    intrinsics = scene.cameras.intrinsics[view].double()
    x = (column + 0.5 - float(intrinsics[0, 2])) / float(intrinsics[0, 0]) * depth
    y = (row + 0.5 - float(intrinsics[1, 2])) / float(intrinsics[1, 1]) * depth
    world_from_cam = invert_rigid(scene.cameras.cam_from_world[view].double())
    point = world_from_cam @ world_from_cam.new_tensor([x, y, depth, 1.0])
    return float(point[0]), float(point[1]), float(point[2])


def upright(scene: instok3d.Scene, floor: Handle) -> instok3d.Scene:
    """The scene with the normal of a floor as its up: cameras held at will do not tell it."""
    box = scene.object(floor.find(scene)).obb
    axes = quat_to_matrix(torch.tensor(box.quat_wxyz))
    normal = axes[:, int(np.argmin(box.size))]
    above = invert_rigid(scene.cameras.cam_from_world)[floor.view, :3, 3] - torch.tensor(box.center)
    x, y, z = (normal if float(normal @ above) > 0 else -normal).tolist()
    return replace(scene, vertical=Vertical((x, y, z), "given cameras", 1.0))


def edited(
    scene: instok3d.Scene, other: instok3d.Scene, edits: Edits
) -> list[UInt8[np.ndarray, "height width 3"]]:
    """The five pictures of a row, in the order of TITLES."""
    view = edits.taken.view
    which, brought = edits.taken.find(scene), edits.brought.find(other)
    base = base_of_object(scene, scene.object(which))
    to = point_at(scene, view, edits.to)
    by = (to[0] - base[0], to[1] - base[1], to[2] - base[2])
    inserted = scene.insert(
        other, brought, point_at(scene, view, edits.at), yaw=edits.brought_yaw, scale=edits.scale
    )
    size = {"height": SIDE, "width": SIDE}
    pictures = [
        scene.render([view], **size),
        scene.render([view], **size, only=which, background=(1.0, 1.0, 1.0)),
        scene.remove(which, claim=True).render([view], **size),
        scene.move(which, by, yaw=edits.yaw).render([view], **size),
        inserted.render([view], **size),
    ]
    return [color_picture(picture.colors[0]) for picture in pictures]


def sheet(sections: list[Section], columns: int, output: Path) -> None:
    """Sections as one JPEG."""
    contact_sheet(sections, columns=columns).save(output, quality=QUALITY, optimize=True)
    print(f"{output}: {output.stat().st_size / 1000:.0f} kB")


def demo_figure(demo: instok3d.Scene, other: instok3d.Scene, output: Path) -> None:
    """Photos, objects, and edits of the demo."""
    ids = demo.render(ids=True).ids
    assert ids is not None
    photos = demo.photos[::2].numpy()
    mixed = (0.35 * photos + 0.65 * id_picture(ids[::2])).astype(np.uint8)
    whole, _, *others = edited(demo, other, DEMO)
    captions = (TITLES[0], *TITLES[2:])
    sections = [
        Section("four of eight photos", enlarged(photos)),
        Section("the objects that were found", enlarged(mixed)),
        Section("edits", [whole, *others], captions),
    ]
    sheet(sections, 4, output)


def enlarged(
    pictures: UInt8[np.ndarray, "view height width 3"],
) -> list[UInt8[np.ndarray, "2*height 2*width 3"]]:
    """Pictures of twice the size."""
    return list(pictures.repeat(2, axis=1).repeat(2, axis=2))


def rooms_figures() -> None:
    """The demo and two test rooms."""
    with tempfile.TemporaryDirectory() as folder:
        demo = instok3d.demo(Path(folder) / "demo.itk", progress=print)
    demo_figure(demo, room_scene(2000005, posed=False), HERE / "demo.jpg")
    scenes = {seed: room_scene(seed, posed=True) for seed in ROOMS}
    others = dict(zip(scenes, reversed(scenes.values()), strict=True))
    rows = [edited(scene, others[seed], ROOMS[seed]) for seed, scene in scenes.items()]
    sheet([Section("", row, TITLES) for row in rows], len(TITLES), HERE / "edits.jpg")


def capture_figure(capture: Path, output: Path) -> None:
    """A real room, with an object of a test room."""
    scene = instok3d.reconstruct(capture, cameras=capture / "scene.json", max_views=8)
    scene = upright(scene, KITCHEN_FLOOR)
    row = edited(scene, room_scene(2000005, posed=True), KITCHEN)
    sheet([Section("", row, TITLES)], len(TITLES), output)


def main() -> None:
    """Make the pictures that the arguments ask for."""
    warnings.simplefilter("ignore")
    if len(sys.argv) == 1:
        rooms_figures()
    elif len(sys.argv) == 3:
        capture_figure(Path(sys.argv[1]), Path(sys.argv[2]))
    else:
        sys.exit((__doc__ or "").strip())


if __name__ == "__main__":
    main()
