"""`instok3d serve`: scenes for other programs, over HTTP and MCP."""

import signal
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from instok3d.scene.scene import Scene
    from instok3d.service.library_tools import LibraryTools
    from instok3d.service.tool import Tools


def run(
    scenes: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(metavar="SCENE|LIB ...", help_behavior_hint="(required)"),
    ],
    /,
    host: str = "127.0.0.1",
    port: int = 8090,
    token: str | None = None,
    teacher: str | None = None,
) -> None:
    """Answer questions about scenes for robots and assistants; Ctrl-C ends it.

    /api/NAME has the tools that /openapi.json describes, /mcp has them over MCP. Nothing is
    changed, and nothing but these scenes and this library can be read. docs/serving.md has more.

    Args:
        scenes: Scene folders, and the folder of a library at most.
        host: Address to listen on. Any but this machine's own needs --token: whoever reaches it and
            has the token can ask, and the network can read along.
        port: The first free one from this on is taken; 0 takes any.
        token: Of the requests, 16 characters or more; a random one without it.
        teacher: What made the features of the library, if it did not come with this package; as in
            `instok3d library query`.
    """
    from instok3d.cli.progress import plain_warnings
    from instok3d.cli.signals import EndedBySignal
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
        served = opened(scenes, teacher)
        guard = Guard(token or random_token(), host, free_port(host, port))
        address = guard.url.partition("?")[0]
        with serving(served, guard):
            print(
                f"{address}openapi.json?token={guard.token}\n{address}mcp\n"
                f"Authorization: Bearer {guard.token}\nCtrl-C ends it", flush=True,
            )  # fmt: skip
            try:
                threading.Event().wait()
            except EndedBySignal as end:
                if end.number != signal.SIGINT:
                    raise


def opened(paths: tuple[Path, ...], teacher: str | None) -> "list[Tools]":
    """What has tools for questions: scenes by the names of their folders, and a library.

    Raises:
        FileNotFoundError: A folder is no scene, or the encoder's weights are not there.
        ValueError: No folder was named, two are libraries, or something is damaged.
    """
    from instok3d.library.opening import is_library
    from instok3d.service.tools import Rooms

    libraries = [path for path in paths if is_library(str(path))]
    if not paths:
        raise ValueError("no scene was named: give scene folders, such as room.itk, or a library")
    if len(libraries) > 1:
        raise ValueError(f"{libraries[0]} and {libraries[1]} are libraries: serve one at a time")
    if teacher is not None and not libraries:
        raise ValueError("--teacher is for questions to a library, and none was named")
    scenes = [path for path in paths if path not in libraries]
    served: list[Tools] = [Rooms(named_scenes(scenes))] if scenes else []
    return served + [_library_tools(path, teacher) for path in libraries]


def _library_tools(path: Path, teacher: str | None) -> "LibraryTools":
    """Without an encoder, which a line says then, a library answers no questions."""
    from instok3d.library.folder import FolderLibrary
    from instok3d.library.questions import library_teacher
    from instok3d.service.library_tools import LibraryTools

    library = FolderLibrary(path)
    asked = None
    try:
        if library.encoder is not None:
            asked = library_teacher(library.encoder, path, teacher)
    except ValueError as error:
        if teacher is not None:
            raise
        print(f"instok3d: note: the library cannot be searched: {error}", file=sys.stderr)
    return LibraryTools(library, asked)


def named_scenes(paths: Sequence[Path]) -> "dict[str, Scene]":
    """The scenes of some folders, by the folders' names.

    Raises:
        FileNotFoundError: A folder is no scene.
        ValueError: A scene is damaged.
    """
    from instok3d.scene.scene import Scene

    found: dict[str, Scene] = {}
    for place in paths:
        name = place.resolve().name
        number = 2
        while name in found:
            name, number = f"{place.resolve().name}-{number}", number + 1
        found[name] = Scene.load(place)
    return found
