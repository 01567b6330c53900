"""Libraries by their places: a folder, or a server."""

from pathlib import Path

from instok3d.library.entries import SceneLibrary
from instok3d.library.folder import FolderLibrary
from instok3d.library.manifest import NAME


def is_library(place: str) -> bool:
    """Whether there is a library at a place."""
    return (Path(place) / NAME).exists()


def open_library(place: str, *, create: bool = False) -> SceneLibrary:
    """The library at a place.

    Args:
        place: A folder.
        create: Make it if it is not there.

    Raises:
        FileNotFoundError: It is not there.
        ValueError: It is damaged, or of a newer version.
        FileExistsError: It is to be made, and something else is there.
    """
    folder = Path(place)
    return FolderLibrary.create(folder) if create else FolderLibrary(folder)
