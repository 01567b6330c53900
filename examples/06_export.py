"""Each object of a scene as a PLY of its own, for any splat viewer.

python examples/02_export.py [room.itk FOLDER]

Without arguments: of demo.itk, which is made if it is not there, into objects/.
"""

import sys
from pathlib import Path

import instok3d
from instok3d.formats.ply import write_ply

given = len(sys.argv) > 1
scene = instok3d.load(sys.argv[1]) if given else instok3d.demo(progress=print)
folder = Path(sys.argv[2] if given else "objects")
folder.mkdir(exist_ok=True)
for item in scene.objects:
    write_ply(folder / f"{item.id:03d}.ply", scene.part(item.id))
    print(f"{item.key}: {item.num_gaussians} Gaussians")
