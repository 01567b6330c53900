"""Each object of a scene as files of its own, with one index."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from PIL import Image

from instok3d.files import json_text, replacing_folder
from instok3d.formats.colliders import write_colliders_glb
from instok3d.formats.parts import file_stem, only_objects
from instok3d.formats.ply import write_scene_ply
from instok3d.formats.registry import ExportOptions
from instok3d.formats.statements import scene_comments
from instok3d.scene.object_pictures import object_picture
from instok3d.scene.scene import Scene

FORMAT = "instok3d-objects-1"
INDEX = "index.json"


def write_object_folder(folder: Path, scene: Scene, options: ExportOptions) -> None:
    """Write NNN.ply, NNN_hull.glb and NNN.png for each object, and index.json, or nothing.

    The PLYs and the boxes in the index are in the scene's world, the hulls have y up. NNN is the
    object's id and its label, where it has one.

    Raises:
        FileExistsError: Something is there, and options.overwrite is off or it is no such folder.
    """
    if folder.is_dir() and any(folder.iterdir()) and not (folder / INDEX).is_file():
        raise FileExistsError(f"{folder} holds other things than exported objects")
    with replacing_folder(folder, overwrite=options.overwrite) as part:
        entries = []
        for item in scene.objects:
            alone, stem = only_objects(scene, [item.id]), file_stem(item)
            write_scene_ply(part / f"{stem}.ply", alone, options)
            write_colliders_glb(part / f"{stem}_hull.glb", alone)
            Image.fromarray(object_picture(scene, item)).save(part / f"{stem}.png")
            files = {"ply": f"{stem}.ply", "hull": f"{stem}_hull.glb", "thumbnail": f"{stem}.png"}
            own = replace(item, gaussian_range=(0, item.num_gaussians))
            entries.append({**own.to_json(scene.vertical.up), "files": files})
        index: dict[str, Any] = {
            "format": FORMAT,
            "about": list(scene_comments(scene)),
            "units": scene.units,
            "up": scene.vertical.up if scene.vertical.is_stated else None,
            "objects": entries,
        }
        (part / INDEX).write_text(json_text(index) + "\n", encoding="utf-8")
