"""Scenes of some of a scene's objects."""

from collections.abc import Sequence
from dataclasses import replace

from instok3d.scene.objects import SceneObject
from instok3d.scene.scene import Scene


def only_objects(scene: Scene, which: Sequence[int | str]) -> Scene:
    """The scene with some of its objects alone, in their order; views and tokens stay.

    Raises:
        KeyError: The scene has no such object.
    """
    chosen = {scene.object(each).id for each in which}
    kept, start = [], 0
    for item in scene.objects:
        if item.id in chosen:
            kept.append(replace(item, gaussian_range=(start, item.num_gaussians)))
            start += item.num_gaussians
    return replace(scene, gaussians=scene.part(list(which)), objects=tuple(kept))


def file_stem(item: SceneObject) -> str:
    """A name for an object's files: its id and, where it has one, its label in plain letters."""
    letters = "".join(
        char if char.isascii() and char.isalnum() else "-" for char in (item.label or "").lower()
    )
    words = "-".join(word for word in letters.split("-") if word)[:40]
    return f"{item.id:03d}_{words}" if words else f"{item.id:03d}"
