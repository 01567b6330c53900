"""An object moved and turned, then given a name; the name undone; the log of what was done.

python examples/04_move.py [room.itk OBJECT moved.itk]

OBJECT is an id, a key such as object#18, or a label. Without arguments: the chair of demo.itk,
which is made if it is not there.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

import instok3d
from instok3d.pictures import color_picture

if len(sys.argv) > 1:
    scene, name, output = instok3d.load(sys.argv[1]), sys.argv[2], Path(sys.argv[3])
    item = scene.object(int(name) if name.isdecimal() else name)
else:
    scene, output = instok3d.demo(progress=print), Path("moved.itk")
    ids = scene.render([3], ids=True).ids[0]
    item = scene.object(int(ids[64, 40]))  # what the fourth photo shows at row 64, column 40

to_the_right_and_nearer = (0.15, 0.05, -0.15)  # scene units, axes of the first camera
moved = scene.move(item.id, to_the_right_and_nearer, yaw=-15).rename(item.id, "chair")
moved = moved.undo()  # of the name
moved.save(output, overwrite=True)

rows = [np.concatenate(color_picture(each.render().colors), axis=1) for each in (scene, moved)]
Image.fromarray(np.concatenate(rows)).save(output.with_suffix(".png"))
for words in instok3d.load(output).edits:
    print(words)
