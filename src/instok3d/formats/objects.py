"""The objects of a scene as data: one JSON object by a published schema, or a table."""

import csv
import io
import re
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Int
from torch import Tensor

from instok3d.formats.masks import coco_mask
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.scene.objects import SceneObject, find_object
from instok3d.scene.scene import Scene

FORMAT, VERSION = "instok3d-objects", 1
SCHEMA = "objects.schema.json"
"""JSON Schema of `objects_data`, in instok3d/assets."""
COLUMNS = ("id", "key", "label", "confidence", "x", "y", "z", "length", "width", "height",
           "num_gaussians", "views", "hidden")  # fmt: skip
"""Of `objects_csv`: centre and full lengths of the oriented box, its longest spread first, but for
height, which is along up."""


@dataclass(frozen=True)
class Scale:
    """How long a scene unit is."""

    metres_per_unit: float | None = None
    """None where nobody knows."""
    source: str = "none"
    """none, "given cameras", or "known: KEY is H m high"."""


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
        return Scale(1.0, "given cameras") if scene.units == "metres" else Scale()
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
    height = height_of(scene, item)
    if not height > 0:
        raise ValueError(f"{item.key} has no height, so that no scale follows from it")
    return Scale(height_m / height, f"known: {item.key} is {height_m:g} m high")


def height_of(scene: Scene, item: SceneObject) -> float:
    """Extent of an object's oriented box along the scene's up, scene units."""
    axes = quat_to_matrix(torch.tensor(item.obb.quat_wxyz, dtype=torch.float64))
    up = torch.tensor(scene.vertical.up, dtype=torch.float64)
    return float((up @ axes).abs() @ torch.tensor(item.obb.size, dtype=torch.float64))


@torch.no_grad()
def objects_data(scene: Scene, scale: Scale | None = None) -> dict[str, Any]:
    """The objects in plain values, by the schema of `SCHEMA`.

    Lengths are in metres where the scale is known, else in scene units. Masks are those of the
    input views at the scene's size, as run lengths in COCO's order.

    Args:
        scene: With any number of views.
        scale: From `find_scale`; None takes what the scene knows itself.
    """
    scale = scale or find_scale(scene)
    ids = scene.render(ids=True).ids if scene.views else None
    made = scene.provenance
    return {
        "format": FORMAT,
        "version": VERSION,
        "units": "arbitrary" if scale.metres_per_unit is None else "metres",
        "metres_per_scene_unit": scale.metres_per_unit,
        "scale_source": scale.source,
        "world": scene.frame,
        "up": list(scene.vertical.up),
        "up_confidence": scene.vertical.confidence,
        "generator": made.generator,
        "model": made.model,
        "edits": len(made.edits),
        "views": [
            {"file": view.file, "height": scene.height, "width": scene.width}
            for view in scene.views
        ],
        "objects": [_object(scene, item, scale.metres_per_unit or 1.0, ids)
                    for item in scene.objects],
    }  # fmt: skip


def objects_csv(scene: Scene, scale: Scale | None = None) -> str:
    """The objects as a table with a line of COLUMNS, lengths as in `objects_data`."""
    stream = io.StringIO()
    table = csv.writer(stream, lineterminator="\n")
    table.writerow(COLUMNS)
    length = (scale or find_scale(scene)).metres_per_unit or 1.0
    for item in scene.objects:
        center = [f"{length * value:.6g}" for value in item.obb.center]
        longest, second, _ = (f"{length * value:.6g}" for value in item.obb.size)
        table.writerow([
            item.id, item.key, item.label or "", f"{item.confidence:.3f}", *center, longest, second,
            f"{length * height_of(scene, item):.6g}", item.num_gaussians,
            " ".join(map(str, item.visible_in)), int(item.hidden),
        ])  # fmt: skip
    return stream.getvalue()


def _object(
    scene: Scene,
    item: SceneObject,
    length: float,
    ids: Int[Tensor, "view height width"] | None,
) -> dict[str, Any]:
    def scaled(values: tuple[float, ...]) -> list[float]:
        return [length * value for value in values]

    return {
        "id": item.id,
        "key": item.key,
        "label": item.label,
        "label_source": None if item.label is None else "given",
        "confidence": item.confidence,
        "hidden": item.hidden,
        "color": item.color,
        "centroid": scaled(item.centroid),
        "height": length * height_of(scene, item),
        "aabb": {"min": scaled(item.aabb.min), "max": scaled(item.aabb.max)},
        "obb": {
            "center": scaled(item.obb.center),
            "size": scaled(item.obb.size),
            "quat_wxyz": list(item.obb.quat_wxyz),
        },
        "num_anchors": item.num_anchors,
        "num_gaussians": item.num_gaussians,
        "gaussian_range": list(item.gaussian_range),
        "embedding_row": None,
        "best_view": None if item.best_view is None else item.best_view.view,
        "seen": [] if ids is None else _seen(ids, item),
    }


def _seen(ids: Int[Tensor, "view height width"], item: SceneObject) -> list[dict[str, Any]]:
    """Where the object is in each view that shows it: box x0, y0, x1, y1 and mask."""
    found = []
    for view in item.visible_in:
        mask = (ids[view] == item.id).cpu().numpy()
        if mask.any():
            coco = coco_mask(mask)
            left, top, width, height = coco["bbox"]
            found.append({
                "view": view, "pixels": coco["area"], "mask": coco["segmentation"],
                "box": [left, top, left + width, top + height],
            })  # fmt: skip
    return found
