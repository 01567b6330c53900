"""An object of one room put into another, where it stands on the floor.

python examples/05_insert.py [room.itk FLOOR other.itk OBJECT inserted.itk]

FLOOR is the object of room.itk that it shall stand on; both are named by id, key or label. Without
arguments: an armchair into demo.itk, out of other.itk, a room that is rendered and reconstructed
if it is not there (pip install '.[rooms]').
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

import instok3d
from instok3d.pictures import color_picture


def another_room(path: Path, seed: int = 2000005, side: int = 128) -> instok3d.Scene:
    """The scene at a path; made of eight pictures of a generated room if it is not there."""
    from instok3d.rooms.denoising import find_denoiser
    from instok3d.rooms.scene import render_scene

    if not path.exists():
        print(f"{path} is not there: making it, in a minute")
        room = render_scene(seed, side, denoiser=find_denoiser())
        with tempfile.TemporaryDirectory() as folder:
            for number, image in enumerate(room.images[::2]):
                Image.fromarray(image).save(f"{folder}/{number}.png")
            instok3d.reconstruct(folder).save(path)
    return instok3d.load(path)


def named(scene: instok3d.Scene, name: str) -> int:
    """The id of an object that was given as id, key or label."""
    return scene.object(int(name) if name.isdecimal() else name).id


if len(sys.argv) > 1:
    scene, other = instok3d.load(sys.argv[1]), instok3d.load(sys.argv[3])
    floor, which = named(scene, sys.argv[2]), named(other, sys.argv[4])
    place, yaw, scale, output = None, 0, None, Path(sys.argv[5])
else:
    scene, other = instok3d.demo(progress=print), another_room(Path("other.itk"))
    floor = int(scene.render([3], ids=True).ids[0, 120, 100])  # photo 4 at row 120, column 100
    ids = other.render([3], ids=True).ids[0]
    which = int(ids[other.height // 2, other.width // 2])  # in the middle of its photo 4
    # Lengths of scenes from photos alone are arbitrary, so that the scale is chosen by eye.
    place, yaw, scale, output = (0.5, 0.2, 0.7), -60, 0.7, Path("inserted.itk")

inserted = scene.insert(other, which, place, on=floor, yaw=yaw, scale=scale)
inserted.save(output, overwrite=True)
new = inserted.objects[-1]
print(f"{new.key} stands on {scene.object(floor).key}, seen in {new.visible_in}")

rows = [np.concatenate(color_picture(each.render().colors), axis=1) for each in (scene, inserted)]
Image.fromarray(np.concatenate(rows)).save(output.with_suffix(".png"))
