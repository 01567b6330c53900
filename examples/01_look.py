"""A scene from between its first two cameras: its colours, objects and depth, side by side.

python examples/01_look.py [room.itk look.png]

Without arguments: of demo.itk, which is made if it is not there.
"""

import sys

import numpy as np
from PIL import Image

import instok3d
from instok3d.pictures import color_picture, depth_picture, id_picture
from instok3d.scene.paths import through

given = len(sys.argv) > 1
scene = instok3d.load(sys.argv[1]) if given else instok3d.demo(progress=print)
output = sys.argv[2] if given else "look.png"

first_two = scene.cameras.views([0, min(1, len(scene.views) - 1)])
between = through(first_two, frames=3).view(1)
pictures = scene.render(between, ids=True)

panels = [
    color_picture(pictures.colors[0]),
    id_picture(pictures.ids[0]),
    depth_picture(pictures.depths[0], farthest=float(pictures.depths.max())),
]
Image.fromarray(np.concatenate(panels, axis=1)).save(output)
for item in scene.objects:
    print(f"{item.key}: {int((pictures.ids == item.id).sum())} pixels")
