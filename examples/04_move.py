"""An object removed, another moved and turned; then the last edit undone, and all kept in a log.

python examples/03_edit.py [room.itk edited.itk]

Without arguments: of demo.itk, which is made if it is not there.
"""

import sys

import instok3d

given = len(sys.argv) > 1
scene = instok3d.load(sys.argv[1]) if given else instok3d.demo(progress=print)
output = sys.argv[2] if given else "edited.itk"
by_size = sorted(scene.objects, key=lambda item: item.num_gaussians)
if len(by_size) < 2:
    sys.exit("this example needs a scene with two objects or more")
largest, second = by_size[-1], by_size[-2]

edited = scene.remove(second.id, claim=True)
edited = edited.move(largest.id, by=(0.1, 0, 0), yaw=15).rename(largest.id, "largest")
edited = edited.undo()  # of the new name
edited.save(output, overwrite=True)
for words in instok3d.load(output).edits:
    print(words)
