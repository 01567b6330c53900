"""An object removed: pictures before, after, and of the hole that is left in each of them.

python examples/03_remove.py [room.itk OBJECT removed.itk]

OBJECT is an id, a key such as object#18, or a label. Without arguments: the chair of demo.itk,
which is made if it is not there.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

import instok3d
from instok3d.pictures import color_picture
from instok3d.scene.edits.certify import certify

if len(sys.argv) > 1:
    scene, name, output = instok3d.load(sys.argv[1]), sys.argv[2], Path(sys.argv[3])
    item = scene.object(int(name) if name.isdecimal() else name)
else:
    scene, output = instok3d.demo(progress=print), Path("removed.itk")
    ids = scene.render([3], ids=True).ids[0]
    item = scene.object(int(ids[64, 40]))  # what the fourth photo shows at row 64, column 40

removed = scene.remove(item.id, claim=True)  # with its halo: what shows nothing but the object
removed.save(output, overwrite=True)

before, after = (color_picture(each.render().colors) for each in (scene, removed))
hole = np.repeat(255 * removed.holes()[..., None].numpy().astype(np.uint8), 3, axis=-1)
rows = [np.concatenate(row, axis=1) for row in (before, after, hole)]
Image.fromarray(np.concatenate(rows)).save(output.with_suffix(".png"))

proof = certify(scene, removed, scene.cameras, scene.height, scene.width)
print(f"{item.key} removed: {proof.gone} Gaussians went, {proof.new} came")
print(f"largest difference in {proof.pixels_outside} pixels outside of it: {proof.outside}")
