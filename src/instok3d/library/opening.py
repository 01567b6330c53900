"""Libraries by their places: a folder, or a Milvus server."""

from pathlib import Path

from instok3d.library.entries import SceneLibrary
from instok3d.library.folder import FolderLibrary
from instok3d.library.manifest import NAME

SERVER = "milvus://"


def is_library(place: str) -> bool:
    """Whether there is a library at a place, with or without scenes.

    Raises:
        ConnectionError, ModuleNotFoundError, ValueError: As `open_library`.
    """
    if place.startswith(SERVER):
        return open_library(place, create=True).encoder is not None
    return (Path(place) / NAME).exists()


def open_library(place: str, *, create: bool = False) -> SceneLibrary:
    """The library at a place.

    Args:
        place: A folder, or milvus://HOST:PORT/NAME.
        create: Make it if it is not there. A server makes it with the first scene.

    Raises:
        FileNotFoundError: It is not there.
        ValueError: It is damaged, or of a newer version.
        FileExistsError: It is to be made, and something else is there.
        ConnectionError: A server does not answer.
        ModuleNotFoundError: The package that talks to it is not installed.
    """
    if place.startswith(SERVER):
        from instok3d.library.milvus import open_milvus

        library = open_milvus(place)
        if library.encoder is None and not create:
            raise FileNotFoundError(
                f"there is no library {place}: `instok3d library add` makes one"
            )
        return library
    folder = Path(place)
    return FolderLibrary.create(folder) if create else FolderLibrary(folder)
