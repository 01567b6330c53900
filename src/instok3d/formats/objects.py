"""The objects of a scene as a table, and its scale by a known height."""

import csv
import io
import re

from instok3d.scene.object_list import Scale, own_scale
from instok3d.scene.objects import find_object
from instok3d.scene.scene import Scene

COLUMNS = ("id", "key", "label", "confidence", "x", "y", "z", "length", "width", "height",
           "num_gaussians", "views", "fragment", "hidden")  # fmt: skip
"""Of `objects_csv`: centre and full lengths of the oriented box, its longest spread first, but for
height, which is along up."""


def find_scale(scene: Scene, wanted: str = "none") -> Scale:
    """The scale of a scene, from its cameras or from the known height of one of its objects.

    Args:
        scene: In metres where its cameras were.
        wanted: "none", or "known:OBJECT=HEIGHT" with the height in metres, along up.

    Raises:
        KeyError: The scene has no such object.
        ValueError: It is of another form, or the scene is in metres already.
    """
    if wanted == "none":
        return own_scale(scene)
    found = re.fullmatch(r"known:(.+)=([0-9.eE+-]+)", wanted)
    try:
        height_m = float(found[2]) if found else 0.0
    except ValueError:
        height_m = 0.0
    if found is None or not 0 < height_m < 1e4:
        raise ValueError(
            f"scale {wanted!r} is none of: none, known:OBJECT=HEIGHT with a height in metres, "
            "such as known:3=0.74"
        )
    if scene.units == "metres":
        raise ValueError("the scene is in metres already, by its given cameras: leave scale out")
    name = found[1].strip("\"'")
    item = find_object(scene.objects, int(name) if name.isdecimal() else name)
    height = item.height_along(scene.vertical.up)
    if not height > 0:
        raise ValueError(f"{item.key} has no height, so that no scale follows from it")
    return Scale(height_m / height, f"known: {item.key} is {height_m:g} m high")


def objects_csv(scene: Scene, scale: Scale | None = None) -> str:
    """The objects as a table with a line of COLUMNS, lengths as in `objects_document`."""
    stream = io.StringIO()
    table = csv.writer(stream, lineterminator="\n")
    table.writerow(COLUMNS)
    length = (scale or find_scale(scene)).metres_per_unit or 1.0
    for item in scene.objects:
        center = [f"{length * value:.6g}" for value in item.obb.center]
        longest, second, _ = (f"{length * value:.6g}" for value in item.obb.size)
        table.writerow([
            item.id, item.key, item.label or "", f"{item.confidence:.3f}", *center, longest, second,
            f"{length * item.height_along(scene.vertical.up):.6g}", item.num_gaussians,
            " ".join(map(str, item.visible_in)), int(item.is_fragment), int(item.hidden),
        ])  # fmt: skip
    return stream.getvalue()
