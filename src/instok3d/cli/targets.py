"""Checks of what a command is asked to write, before it does any work."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from instok3d.scene.scene import Scene


def check_file(path: Path, *, overwrite: bool, endings: tuple[str, ...]) -> None:
    """Fail if a file cannot be written at `path`.

    Raises:
        ValueError: Its name ends in none of the endings.
        FileNotFoundError: The folder that it is to stand in is not there.
        FileExistsError: Something is there, and overwrite is off or it is no file.
    """
    if path.suffix.lower() not in endings:
        raise ValueError(f"cannot write {path}: the name must end in {' or '.join(endings)}")
    check_target(path, overwrite=overwrite)


def check_target(path: Path, *, overwrite: bool, folder: bool = False) -> None:
    """Fail if a file, or a folder, cannot be written at `path`.

    Raises:
        FileNotFoundError: The folder that it is to stand in is not there.
        FileExistsError: Something is there, and overwrite is off or it is of another kind.
    """
    if not path.resolve().parent.is_dir():
        raise FileNotFoundError(f"cannot write {path}: there is no folder {path.resolve().parent}")
    if path.exists() and not (overwrite and (path.is_dir() if folder else path.is_file())):
        raise FileExistsError(f"{path} is already there; pass --overwrite to replace it")


def load_scene(path: Path, up: tuple[str, ...] | None) -> "Scene":
    """A scene, for this command with another up where one is given.

    Raises:
        FileNotFoundError, ValueError: See `Scene.load` and `given_up`.
    """
    from instok3d.cli.progress import plain_warnings
    from instok3d.scene.scene import Scene
    from instok3d.scene.vertical import given_up

    vertical = None if up is None else given_up(up)
    with plain_warnings():
        scene = Scene.load(path)
    return scene if vertical is None else replace(scene, vertical=vertical)


def objects_by_words(scene: "Scene", text: str) -> list[int]:
    """Ids of the objects that a person names, by id, key or label, or in words ("the red chair").

    Words are understood where the scene has semantics of the encoder that comes with instok3d.

    Raises:
        KeyError: There is no such object, or the words may mean several; says which.
        ValueError: The words are not understood.
    """
    from instok3d.scene.query import named_objects
    from instok3d.semantics.query.shipped import shipped_encoder

    encoder = shipped_encoder(scene.semantics) if scene.semantics else None
    return [item.id for item in named_objects(scene, text, encoder)]


def object_by_words(scene: "Scene", text: str) -> int:
    """The id of the one object that a person names, as `objects_by_words`.

    Raises:
        KeyError: There is no such object, or several.
        ValueError: The words are not understood, or ask for several.
    """
    first, *more = objects_by_words(scene, text)
    if more:
        raise ValueError(f"{text!r} means {1 + len(more)} objects: name one of them")
    return first
