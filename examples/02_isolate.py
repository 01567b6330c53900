"""One object alone: drawn at the photos' cameras, and kept as a scene of its own.

python examples/02_isolate.py [room.itk OBJECT alone.itk]

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
    scene, output = instok3d.demo(progress=print), Path("alone.itk")
    ids = scene.render([3], ids=True).ids[0]
    item = scene.object(int(ids[64, 40]))  # what the fourth photo shows at row 64, column 40

alone = scene.only(item.id)
alone.save(output, overwrite=True)

pictures = color_picture(alone.render(background=(1.0, 1.0, 1.0)).colors)
Image.fromarray(np.concatenate(pictures, axis=1)).save(output.with_suffix(".png"))
print(f"{item.key}: {item.num_gaussians} of {len(scene.gaussians.means)} Gaussians, in {output}")
