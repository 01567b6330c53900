"""A scene as files for other programs: Blender, game engines, the web.

python examples/06_export.py [room.itk FOLDER]

Without arguments: of demo.itk, which is made if it is not there, into exported/.
"""

import sys
from pathlib import Path

import instok3d
from instok3d.formats.layouts import write_layout
from instok3d.formats.object_folder import write_object_folder
from instok3d.formats.registry import ExportOptions, export_scene

given = len(sys.argv) > 1
scene = instok3d.load(sys.argv[1]) if given else instok3d.demo(progress=print)
folder = Path(sys.argv[2] if given else "exported")
folder.mkdir(exist_ok=True)
options = ExportOptions(overwrite=True)

export_scene(scene, folder / "room.html", options)  # any browser, offline: click on an object
export_scene(scene, folder / "room.spz", options)  # web viewers: the smallest, ids in room.spz.json
export_scene(scene, folder / "room.ply", options)  # SuperSplat, Blender's add-ons for splats
export_scene(scene, folder / "room.glb", options)  # glTF with splats: one node for each object
write_layout("colliders", folder / "hulls.glb", scene, overwrite=True)  # meshes: Blender as it is
write_object_folder(folder / "objects", scene, options)  # a PLY, hull, picture for each object

for path in sorted(folder.iterdir()):
    if path.is_file():
        print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")
print(f"{folder / 'objects'}: {len(scene.objects)} objects")
