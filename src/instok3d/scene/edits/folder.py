"""Scenes with their logs in folders: read, written, edited in place."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from instok3d.hub.references import is_hub
from instok3d.locking import alone_in
from instok3d.scene.edits.history import History
from instok3d.scene.edits.log import LOG, read_log, write_log
from instok3d.scene.files import load_record, read_digest, save_record, write_edited
from instok3d.scene.record import SceneRecord

LOCK = ".edits.lock"


def read_history(path: Path, *, hub: str = "") -> History:
    """What the folder of a scene holds, and the edits of its log.

    Args:
        path: The folder.
        hub: As `load_record`.

    Raises:
        FileNotFoundError: No folder there, or a file of it is missing.
        ValueError: It is of a newer version, damaged, or inconsistent.
    """
    source = load_record(path, hub=hub)
    digest, edited = read_digest(path)
    if edited and not (path / LOG).is_file():
        raise FileNotFoundError(
            f"the scene is incomplete: {path / LOG} is missing, by scene.json it has {edited} edits"
        )
    return read_log(path, source, digest)


def save_history(
    scene: SceneRecord,
    history: History | None,
    path: Path,
    *,
    overwrite: bool = False,
    more: Callable[[Path], None] | None = None,
) -> None:
    """Write a scene folder: the source and the log where the edits give the scene, else the scene.

    The arguments, but for the history, and the errors are those of `save_record`.
    """
    logged = history is not None and history.gives(scene) and (history.edits or history.undone)
    if history is None or not logged:
        save_record(scene, path, overwrite=overwrite, more=more)
        return

    def with_log(folder: Path) -> None:
        if more is not None:
            more(folder)
        write_log(folder, history)

    save_record(history.source, path, overwrite=overwrite, more=with_log, edited=len(history.edits))


@contextmanager
def editing(path: Path) -> Iterator[None]:
    """Keep others from editing the scene of a folder during the block.

    Raises:
        ValueError: Another run edits it, or it is on the hub.
        FileNotFoundError: It is not there.
    """
    check_editable(path)
    with alone_in(path / LOCK, f"another run is editing {path}; wait for its end"):
        yield


def check_editable(path: Path) -> None:
    """Fail for what is no folder that a log of edits could be written into.

    Raises:
        ValueError: It is a name of the hub.
        FileNotFoundError: It is not there.
    """
    if is_hub(path):
        raise ValueError(
            f"{path.as_posix()} is on the hub, where nothing is edited: take a copy "
            f"(instok3d import {path.as_posix()} -o room.itk)"
        )
    if not path.is_dir():
        raise FileNotFoundError(f"{path} is not a scene folder: no folder of this name is there")


def keep_log(path: Path, history: History) -> None:
    """Make the log of a folder that of a history which began with the folder's scene.

    The other files stay as they are, but for the number of edits in scene.json. Call it inside of
    `editing`.
    """
    write_log(path, history)
    write_edited(path, history.source, len(history.edits))
