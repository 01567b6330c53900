"""`instok3d view`: a scene in the browser, to look at and to edit."""

import math
import signal
import sys
import threading
from pathlib import Path
from typing import Annotated

import tyro


def run(
    scenes: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(metavar="SCENE ...", help_behavior_hint="(required)"),
    ],
    /,
    read_only: bool = False,
    host: str = "127.0.0.1",
    port: int = 8080,
    token: str | None = None,
    open: bool = False,
    upload_limit: float = 256.0,
) -> None:
    """Show a scene in the browser, to look at and to edit; Ctrl-C ends it.

    Each edit is in the scene's log at once, as by `instok3d edit`; undo takes it back.

    Args:
        scenes: A scene folder; of further ones, objects can be inserted.
        read_only: Keep edits in memory alone; they are gone at the end.
        host: Address to listen on. Any but this machine's own needs --token: whoever reaches it and
            has the token can look and edit, and the network can read along.
        port: The first free one from this on is taken; 0 takes any.
        token: Part of the address, 16 characters or more; a random one without it.
        open: Open the address in a browser.
        upload_limit: Megabytes of a file that the browser may send to insert objects from; 0 turns
            that off.
    """
    import webbrowser

    from instok3d.cli.progress import plain_warnings
    from instok3d.cli.signals import EndedBySignal
    from instok3d.scene.scene import Scene
    from instok3d.viewer.app import view
    from instok3d.viewer.folder import SceneFolder
    from instok3d.viewer.guard import is_loopback
    from instok3d.viewer.serving import require_viser
    from instok3d.viewer.uploads import MEGABYTE

    if not scenes:
        raise ValueError("no scene was named: give a scene folder, such as room.itk")
    if not (math.isfinite(upload_limit) and upload_limit >= 0):
        raise ValueError(
            f"--upload-limit must be megabytes, 0 (no uploads) or more, got {upload_limit:g}"
        )
    if not is_loopback(host):
        if token is None:
            raise ValueError(
                f"--host {host} lets other machines in: give a --token of 16 characters or more, "
                "which they need"
            )
        print(
            f"instok3d: note: other machines can reach {host}; whoever has the token can look and "
            "edit, and the network can read along (an SSH tunnel to 127.0.0.1 is safer)",
            file=sys.stderr,
        )
    require_viser()
    with plain_warnings():
        folder = SceneFolder(scenes[0])
        others = {str(path): Scene.load(path) for path in scenes[1:]}
        viewer = view(
            folder.opened, folder=None if read_only else folder, others=others,
            host=host, port=port, token=token, title=scenes[0].resolve().name,
            upload_limit_bytes=round(upload_limit * MEGABYTE),
        )  # fmt: skip
        try:
            print(f"{viewer.url}\nCtrl-C ends the viewer", flush=True)
            if open:
                webbrowser.open(viewer.url)
            threading.Event().wait()
        except EndedBySignal as end:
            if end.number != signal.SIGINT:
                raise
        finally:
            viewer.stop()
            folder.renew_previews(viewer.scene)
