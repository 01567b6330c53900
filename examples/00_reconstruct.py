"""Photos in, a scene of objects out.

python examples/00_reconstruct.py [PHOTOS room.itk]

Without arguments: the demo's photos and demo.itk, which is made if it is not there.
"""

import sys

import instok3d

if len(sys.argv) > 1:
    scene = instok3d.reconstruct(sys.argv[1], progress=print)
    scene.save(sys.argv[2])
else:
    scene = instok3d.demo(progress=print)
for item in scene.objects:
    length, width, height = item.obb.size
    print(f"{item.key}: {length:.2f} x {width:.2f} x {height:.2f}, seen in {item.visible_in}")
