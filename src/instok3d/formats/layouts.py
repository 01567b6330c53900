"""Exports that are more than one file of Gaussians: cameras, masks, solids, boxes, by name."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from instok3d.scene.scene import Scene


@dataclass(frozen=True)
class Layout:
    """One kind of export."""

    about: str
    module: str
    """In instok3d.formats; imported when it is used."""
    writer: str
    """A function of a path, a `Scene` and `overwrite`."""
    suffixes: tuple[str, ...] = ()
    """Endings of the file; none: it is a folder."""


LAYOUTS = {
    "colmap": Layout("a COLMAP model in text", "colmap", "write_colmap"),
    "nerfstudio": Layout("transforms.json", "nerfstudio", "write_nerfstudio", (".json",)),
    "masks": Layout("16-bit id PNGs and COCO instances", "masks", "write_masks"),
    "colliders": Layout("convex hulls", "colliders", "write_colliders", (".glb", ".json")),
    "boxes": Layout("oriented boxes as meshes", "colliders", "write_boxes_glb", (".glb",)),
    "ros": Layout("Detection3DArray", "ros", "write_ros", (".json",)),
}


def check_layout(name: str, path: Path) -> Layout:
    """The layout of a name, if a path is one for it.

    Raises:
        KeyError: There is none of this name.
        ValueError: The path has another ending.
    """
    if name not in LAYOUTS:
        raise KeyError(f"no format {name!r}; the formats are: {', '.join(LAYOUTS)}")
    layout = LAYOUTS[name]
    if layout.suffixes and path.suffix.lower() not in layout.suffixes:
        wanted = " or ".join(layout.suffixes)
        raise ValueError(f"cannot write {path}: --format {name} makes a file that ends in {wanted}")
    return layout


def write_layout(name: str, path: Path, scene: Scene, *, overwrite: bool = False) -> None:
    """Write a scene's cameras, masks, solids or boxes, atomically.

    Args:
        name: One of LAYOUTS.
        path: A file or folder, as the layout has it.
        scene: What to write.
        overwrite: Replace what is there, if it is of this kind.

    Raises:
        FileExistsError: Something is there, and overwrite is off or it is of another kind.
        KeyError: There is no such layout.
        ValueError: The path has another ending, or the scene lacks views.
    """
    layout = check_layout(name, path)
    writer: Callable = getattr(import_module(f"instok3d.formats.{layout.module}"), layout.writer)
    writer(path, scene, overwrite=overwrite)


def check_views(scene: Scene, what: str) -> None:
    """Refuse a scene without views.

    Raises:
        ValueError: It has none.
    """
    if not scene.views:
        raise ValueError(f"this scene was imported and has no views, of which {what} consists")
