"""A scene folder into a library."""

from pathlib import Path

from instok3d.library.opening import is_library, open_library
from instok3d.library.scenes import choose_encoder, entries_of, scene_place
from instok3d.scene.scene import Scene


def add_scene(library: str, path: Path, encoder: str | None = None) -> int:
    """Add the scene of a folder to a library, which is made if it is not there.

    Args:
        library: Its place, as `open_library` takes it.
        path: The scene folder.
        encoder: Whose features are taken; None takes the library's, or the only ones.

    Returns:
        How many objects it has.

    Raises:
        FileNotFoundError: There is no such scene.
        ValueError: It has no features of the library's encoder, or something is damaged.
    """
    scene = Scene.load(path)
    opened = open_library(library) if is_library(library) else None
    wanted = encoder or (opened.encoder.name if opened and opened.encoder else None)
    entries = entries_of(scene, choose_encoder(scene, path, wanted), path)
    opened = opened or open_library(library, create=True)  # only now is there reason to
    opened.add(scene_place(path), entries)
    return len(entries.objects)


def holds_scene(library: str, path: Path) -> bool:
    """Whether a library, which may not be there yet, holds the scene of a folder.

    Raises:
        ConnectionError, ModuleNotFoundError, ValueError: As `open_library`.
    """
    if not is_library(library):
        return False
    return any(each.scene == scene_place(path) for each in open_library(library).scenes())
