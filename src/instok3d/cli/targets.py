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
    from instok3d.scene.scene import Scene
    from instok3d.scene.vertical import given_up

    vertical = None if up is None else given_up(up)
    scene = Scene.load(path)
    return scene if vertical is None else replace(scene, vertical=vertical)


def object_name(text: str) -> int | str:
    """An object's id or key as it was typed."""
    return int(text) if text.isdecimal() else text
