"""Photos in, a scene of objects out.

python examples/00_reconstruct.py PHOTOS room.itk
"""

import sys

import instok3d

scene = instok3d.reconstruct(sys.argv[1], progress=print)
for item in scene.objects:
    length, width, height = item.obb.size
    print(f"{item.key}: {length:.2f} x {width:.2f} x {height:.2f}, seen in {item.visible_in}")
scene.save(sys.argv[2])
