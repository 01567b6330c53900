"""`instok3d serve`: scenes for other programs, over HTTP and MCP."""

import signal
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from instok3d.scene.scene import Scene


def run(
    scenes: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(metavar="SCENE|LIB ...", help_behavior_hint="(required)"),
    ],
    /,
    host: str = "127.0.0.1",
    port: int = 8090,
    token: str | None = None,
) -> None:
    """Answer questions about scenes for robots and assistants; Ctrl-C ends it.

    GET /api/NAME has the tools that /openapi.json describes, /mcp has them over MCP. Nothing is
    changed, and nothing but these scenes can be read. docs/serving.md has more.

    Args:
        scenes: Scene folders, or the folder of a library, whose scenes are served.
        host: Address to listen on. Any but this machine's own needs --token: whoever reaches it and
            has the token can ask, and the network can read along.
        port: The first free one from this on is taken; 0 takes any.
        token: Of the requests, 16 characters or more; a random one without it.
    """
    from instok3d.cli.progress import plain_warnings
    from instok3d.cli.signals import EndedBySignal
    from instok3d.service.tools import Rooms
    from instok3d.service.web import require_service, serving
    from instok3d.viewer.guard import Guard, is_loopback, random_token
    from instok3d.viewer.serving import free_port

    if not is_loopback(host):
        if token is None:
            raise ValueError(
                f"--host {host} lets other machines in: give a --token of 16 characters or more, "
                "which they need"
            )
        print(
            f"instok3d: note: other machines can reach {host}; whoever has the token can ask, and "
            "the network can read along (an SSH tunnel to 127.0.0.1 is safer)",
            file=sys.stderr,
        )
    require_service()
    with plain_warnings():
        rooms = Rooms(named_scenes(scenes))
        guard = Guard(token or random_token(), host, free_port(host, port))
        address = guard.url.partition("?")[0]
        with serving(rooms, guard):
            print(
                f"{address}openapi.json?token={guard.token}\n{address}mcp\n"
                f"Authorization: Bearer {guard.token}\nCtrl-C ends it", flush=True,
            )  # fmt: skip
            try:
                threading.Event().wait()
            except EndedBySignal as end:
                if end.number != signal.SIGINT:
                    raise


def named_scenes(paths: tuple[Path, ...]) -> "dict[str, Scene]":
    """The scenes of some folders, by the folders' names; those of a library, if it is one.

    Raises:
        FileNotFoundError: A folder is no scene.
        ValueError: No folder was named, or a scene is damaged.
    """
    from instok3d.library.folder import FolderLibrary
    from instok3d.scene.scene import Scene

    if len(paths) == 1 and (paths[0] / "library.json").is_file():
        places = [Path(each.scene) for each in FolderLibrary(paths[0]).scenes()]
    else:
        places = list(paths)
    if not places:
        raise ValueError("no scene was named: give scene folders, such as room.itk, or a library")
    found: dict[str, Scene] = {}
    for place in places:
        name = place.resolve().name
        number = 2
        while name in found:
            name, number = f"{place.resolve().name}-{number}", number + 1
        found[name] = Scene.load(place)
    return found
