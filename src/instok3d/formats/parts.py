"""Parts of scenes: some of its objects, or each of them by itself."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from instok3d.formats.upright import rigid_turn, y_up
from instok3d.geometry.moving import move_gaussians
from instok3d.scene.objects import SceneObject
from instok3d.scene.scene import Scene
from instok3d.types import Gaussians

REST = "rest"
"""Name of what belongs to no object."""


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


def y_up_parts(scene: Scene) -> Iterator[tuple[str, SceneObject | None, Gaussians]]:
    """Name and Gaussians of each object and of the rest, on the CPU, turned so that y is up."""
    gaussians = scene.gaussians.map(lambda tensor: tensor.detach().cpu())
    gaussians = move_gaussians(gaussians, rigid_turn(y_up(scene.vertical)))
    end = 0
    for item in scene.objects:
        start, count = item.gaussian_range
        end = start + count
        yield item.key, item, gaussians.rows(slice(start, end))
    yield REST, None, gaussians.rows(slice(end, None))


def with_degree(gaussians: Gaussians, degree: int) -> Gaussians:
    """The Gaussians without the bands of colour above a degree."""
    return replace(gaussians, sh=gaussians.sh[:, : (degree + 1) ** 2])
