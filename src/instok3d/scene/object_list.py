"""objects.json: the objects of a scene by a published schema, and read again in a scene folder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from instok3d.reading import naming_damage, one_of, read_json, whole_number
from instok3d.scene.neighbours import Neighbour, as_values
from instok3d.scene.objects import SceneObject
from instok3d.scene.record import SceneRecord

FORMAT, VERSION = "instok3d-objects", 4
SCHEMA = "objects.schema.json"
"""JSON Schema of `objects_document`, in instok3d/assets."""


@dataclass(frozen=True)
class Scale:
    """How long a scene unit is."""

    metres_per_unit: float | None = None
    """None where nobody knows."""
    source: str = "none"
    """none, "given cameras", or "known: KEY is H m high"."""


def own_scale(scene: SceneRecord) -> Scale:
    """The scale that a scene knows itself."""
    return Scale(1.0, "given cameras") if scene.units == "metres" else Scale()


def objects_document(
    scene: SceneRecord,
    scale: Scale | None = None,
    neighbours: Mapping[int, Sequence[Neighbour]] | None = None,
) -> dict[str, Any]:
    """The objects in plain values, by the schema of `SCHEMA`.

    Lengths are in metres where the scale is known, else in scene units. Masks are those of the
    input views at the scene's size, as run lengths in COCO's order, as if no object was hidden.

    Args:
        scene: With any number of views.
        scale: None takes what the scene knows itself.
        neighbours: Of each object by id, from `Scene.neighbours`; None leaves them out, as in a
            scene folder, since to find them is to render the input views.
    """
    scale, made = scale or own_scale(scene), scene.provenance
    length = scale.metres_per_unit or 1.0
    objects = [item.to_json(scene.vertical.up, length=length) for item in scene.objects]
    if scene.semantics:
        objects = [each | {"embedding_row": each["id"] - 1} for each in objects]
    if neighbours is not None:
        objects = [each | {"neighbours": as_values(neighbours[each["id"]])} for each in objects]
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
        "objects": objects,
    }


def read_objects(
    file: Path,
    remedy: str,
    *,
    num_views: int,
    height: int,
    width: int,
    num_gaussians: int,
    num_groups: int,
) -> tuple[SceneObject, ...]:
    """The objects of a scene.

    Args:
        file: objects.json.
        remedy: What to do about a damaged one.
        num_views: Of the scene.
        height: Of its views, pixels.
        width: Likewise.
        num_gaussians: Of the scene.
        num_groups: Likewise.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged, or does not fit the scene.
    """
    if not file.is_file():
        raise FileNotFoundError(f"the scene is incomplete: {file} is missing")
    value = read_json(file, remedy)
    with naming_damage(file, remedy):
        entries = _entries(value, file)
        objects = tuple(SceneObject.from_json(entry) for entry in entries)
        ids = [item.id for item in objects]
        if len({item.key for item in objects}) != len(ids):
            raise ValueError("two objects have one key")
        if len(set(ids)) != len(ids) or any(not 1 <= i <= num_groups for i in ids):
            raise ValueError("its ids are not distinct or not those of groups")
        end = 0
        for item in objects:
            start, count = item.gaussian_range
            if start != end or count < 1 or start + count > num_gaussians:
                raise ValueError(f"gaussian_range {start}, {count} of {item.key!r} cannot be")
            if count != item.num_gaussians:
                raise ValueError(f"num_gaussians of {item.key!r} is not that of its range, {count}")
            _check_sight(item, num_views, height, width)
            end = start + count
    return objects


def _entries(value: Any, file: Path) -> list[Any]:
    """The list of the objects; scene folders of versions 1 to 3 hold nothing else."""
    if isinstance(value, list):
        return value
    one_of(value["format"], (FORMAT,))
    version = whole_number(value["version"], 1)
    if version > VERSION:
        raise ValueError(
            f"{file}: this program reads objects of version {VERSION}, not {version}; use a newer "
            "program"
        )
    if not isinstance(value["objects"], list):
        raise ValueError("it holds no list of objects")
    return value["objects"]


def _check_sight(item: SceneObject, num_views: int, height: int, width: int) -> None:
    best = item.best_view
    named = item.visible_in if best is None else (*item.visible_in, best.view)
    if not all(0 <= view < num_views for view in named):
        raise ValueError(f"{item.key!r} names a view that is not there")
    for mask in item.sight.masks:
        if (mask.height, mask.width) != (height, width):
            raise ValueError(f"a mask of {item.key!r} is not of {height} x {width}")
    if best is not None:
        x0, y0, x1, y1 = best.bbox
        if not (x0 < x1 <= width and y0 < y1 <= height):
            raise ValueError(f"the bbox of {item.key!r} is not within {height} x {width}")


def read_entries(file: Path, remedy: str) -> list[Any]:
    """The list that a JSON file of a scene holds.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged, or holds no list.
    """
    if not file.is_file():
        raise FileNotFoundError(f"the scene is incomplete: {file} is missing")
    entries = read_json(file, remedy)
    if not isinstance(entries, list):
        raise ValueError(f"{file} is damaged (it holds no list); {remedy}")
    return entries
