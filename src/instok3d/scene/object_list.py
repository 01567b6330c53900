"""objects.json of a scene folder: read and checked against the scene's other files."""

from pathlib import Path
from typing import Any

from instok3d.reading import naming_damage, read_json
from instok3d.scene.objects import SceneObject


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
    entries = read_entries(file, remedy)
    with naming_damage(file, remedy):
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


def _check_sight(item: SceneObject, num_views: int, height: int, width: int) -> None:
    best = item.best_view
    named = item.visible_in if best is None else (*item.visible_in, best.view)
    if not all(0 <= view < num_views for view in named):
        raise ValueError(f"{item.key!r} names a view that is not there")
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
