"""The folder of the scene at the viewer: where its edits are kept, and beside which copies go."""

import os
from pathlib import Path

from instok3d.scene.edits.folder import check_editable, editing, keep_log
from instok3d.scene.edits.log import LOG
from instok3d.scene.previews import save_with_previews, write_previews_anew
from instok3d.scene.scene import Scene

ENDING = ".itk"
LONGEST = 100
"""Characters of the name of a scene."""


class SceneFolder:
    """A scene folder whose log grows with each edit, as by `instok3d edit`.

    `opened` is the scene as it was when the folder was opened.
    """

    def __init__(self, path: Path) -> None:
        """Open a folder.

        Raises:
            FileNotFoundError, ValueError: See `Scene.load`.
        """
        check_editable(path)
        self.path = path
        # Before the scene: an edit by another run in between makes the first edit here fail.
        self._log = self._read_log()
        self.opened = Scene.load(path)
        self._previews_are_old = False

    def keep(self, scene: Scene) -> None:
        """Write the log of a scene that began with the folder's.

        Raises:
            ValueError: Another run edits the folder, or has since it was opened.
            FileNotFoundError: It is gone.
        """
        if scene.history is None:
            return
        with editing(self.path):
            if self._read_log() != self._log:
                raise ValueError(
                    f"another run has edited {self.path} meanwhile: end this one and start it anew"
                )
            keep_log(self.path, scene.history)
            self._log = self._read_log()
            self._previews_are_old = True

    def renew_previews(self, scene: Scene) -> None:
        """Exchange the previews for those of the scene, where it was edited and they are there."""
        if self._previews_are_old:
            write_previews_anew(scene, self.path)
            self._previews_are_old = False

    def save_beside(self, scene: Scene, name: str) -> Path:
        """Write a scene folder of this name, source and log included, in the same folder.

        Raises:
            FileExistsError: Something of this name is there.
            ValueError: It is no plain name that ends in .itk.
        """
        plain = name.strip()
        if (
            not plain.endswith(ENDING)
            or plain.startswith(".")
            or len(plain) > LONGEST
            or not plain.isprintable()
            or any(sign in plain for sign in '/\\:*?"<>|')
        ):
            raise ValueError(
                f"cannot save as {plain[:80]!r}: give a name such as room2.itk, without folders"
            )
        path = self.path.resolve().parent / plain
        if os.path.lexists(path):
            raise FileExistsError(f"{plain} is already there: give another name")
        save_with_previews(scene, path)
        return path

    def _read_log(self) -> bytes | None:
        file = self.path / LOG
        return file.read_bytes() if file.is_file() else None
