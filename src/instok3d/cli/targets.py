"""Checks of what a command is asked to write, before it does any work."""

from pathlib import Path


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


def object_name(text: str) -> int | str:
    """An object's id or key as it was typed."""
    return int(text) if text.isdecimal() else text
