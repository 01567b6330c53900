"""Each object of a scene as a PLY of its own, for any splat viewer.

python examples/02_export.py room.itk FOLDER
"""

import sys
from pathlib import Path

import instok3d
from instok3d.scene.ply import write_ply

scene = instok3d.load(sys.argv[1])
folder = Path(sys.argv[2])
folder.mkdir(exist_ok=True)
for item in scene.objects:
    write_ply(folder / f"{item.id:03d}.ply", scene.part(item.id))
    print(f"{item.key}: {item.num_gaussians} Gaussians")
